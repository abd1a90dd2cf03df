//! `[service]` and `[safety]` of a board file: who may command, and what is safe.

use crate::control::LoopConfig;
use crate::parameters;
use crate::supervisor::cycle::restart_check::RestartCheckConfig;
use crate::supervisor::{GateLimits, ResidualConfig, SafeStates};
use std::path::PathBuf;

parameters! {
    /// The service: sockets, state folder and the loop's thread.
    pub struct ServiceSection {
        /// Socket for commands. Whoever may connect may command, so its folder and group decide. There is no network port. Left
        /// out, `control.sock` in `/run/retroflex` for root and under systemd, in `$XDG_RUNTIME_DIR/retroflex` for anybody else.
        socket: Option<PathBuf> = None;
        /// Socket for reading the status only. Left out, `status.sock` beside the other.
        status_socket: Option<PathBuf> = None;
        /// Permission bits of the command socket; the default is owner and group.
        socket_mode: u32 = 0o660, "octal", 0..=511, "write it in octal, such as 0o660";
        /// Permission bits of the status socket; the default is everybody.
        status_mode: u32 = 0o666, "octal", 0..=511, "write it in octal, such as 0o666";
        /// Folder of what must survive a restart, and of the recordings. Left out, `/var/lib/retroflex` for root and under
        /// systemd, `$XDG_STATE_HOME/retroflex` or `~/.local/state/retroflex` for anybody else.
        state: Option<PathBuf> = None;
        /// A stream of set-points that is silent for this long has ended, and the tip stops. A larger value tolerates a slower
        /// sender and lets the tip continue for longer without one.
        dead_man_s: f64 = 0.25, "s", 0.02..=5.0, "a few periods of the sender";
        /// A client that is still connected for this long after it commanded a motion attends it: if it disconnects before the
        /// motion has ended, the tip holds. A larger value lets more clients leave a motion to itself.
        attended_s: f64 = 0.25, "s", 0.0..=1e6, "longer than a command that only sends and ends";
        /// An armed tip that has held its pose for this long without a command returns to rest and is disarmed; left out, it holds
        /// for as long as it is armed. A larger value lets the drivers and what the tip touches wait longer.
        hold_max_s: Option<f64> = None, "s", 1.0..=1e6, "longer than any procedure holds one pose";
        /// Longest recording.
        record_max_s: f64 = 3600.0, "s", 1.0..=1e6, "an hour";
        /// Largest recording, bend log and flight log together. A larger value fills more of the disk.
        record_max_mib: f64 = 1024.0, "MiB", 1.0..=1e6, "1024 is some hours, compressed";
        /// A recording ends, and the flight log pauses, when less of the disk is free. A larger value leaves more to the
        /// state and to others.
        record_free_mib: f64 = 256.0, "MiB", 1.0..=1e6, "the state needs 1 MiB";
        /// Flight logs of all runs together; the oldest files are deleted first. 0 writes none. A larger value keeps more runs and
        /// fills more of the disk.
        flight_max_mib: f64 = 1024.0, "MiB", 0.0..=1e6, "1024 is about ten hours";
        /// A flight log continues in a new file when it is larger. A larger value makes fewer files.
        flight_file_mib: f64 = 128.0, "MiB", 1.0..=1e5, "128 is about an hour";
        /// A flight log continues in a new file after this time. A larger value makes fewer files.
        flight_file_s: f64 = 3600.0, "s", 1.0..=1e6, "an hour";
        /// SCHED_FIFO priority of the loop, below that of the step thread; 0 requests none. A larger value displaces more of the
        /// system.
        priority: i32 = 70, "", 0..=99, "below the step thread; 0 requests none";
        /// Processor that the loop stays on, from 0; left out, any.
        cpu: Option<usize> = None;
        /// Period at which the piston positions are written to disk while armed. A smaller value loses less after a power cut
        /// and wears the card.
        checkpoint_s: f64 = 0.2, "s", 0.02..=60.0, "0.2 is 5 writes a second while armed";
    }
}

parameters! {
    /// The gate between controller and step generator. Travel, speed and acceleration come from `[limits]` and `[motion]`; this
    /// table sets how close to them the controller may come, and the other conditions. Once tripped, the gate stays so until
    /// `retroflex reset-fault`.
    pub struct SafetySection: Copy {
        /// Speed at which the gate trips, as a multiple of `motion.speed_max_mm_s`. A larger value trips later.
        speed_share: f64 = 1.15, "", 1.0..=3.0, "1.15 leaves room for rounding";
        /// Acceleration at which the gate trips, as a multiple of `motion.acceleration_max_mm_s2`; the gate counts microsteps
        /// over 16 turns and cannot separate their grain from acceleration. A larger value trips later.
        acceleration_share: f64 = 2.0, "", 1.0..=20.0, "2 leaves room for the grain of microsteps";
        /// Gauge pressure at which the gate trips; the default is the paper's 6 PSI. A larger value risks the bellow.
        pressure_max_kpa: f64 = 41.3, "kPa", 1.0..=200.0, "the paper stays under 6 PSI = 41.4 kPa";
        /// Gauge pressure, of either sign, at which the relief valve of every line opens; left out, there are no valves. A motor
        /// that can make more than `pressure_max_kpa` needs valves or pressure sensors, because the program limits the pressure
        /// only by the position that it believes. A larger value lets a failed program press harder.
        relief_valve_kpa: Option<f64> = None, "kPa", 1.0..=200.0, "as stamped on the valve; above limits.pressure_max_kpa";
        /// Temperature of the tip, as the IMU's die measures it, at which the status reports a warm tip.
        tip_warm_c: f64 = 39.0, "°C", 20.0..=85.0, "a few degrees below tip_max_c";
        /// Temperature of the tip at which the gate trips. IEC 60601-1 limits what heats a patient without intent to 41 °C. The die
        /// is not the surface: see `imu.temp_offset_c`. A larger value permits a hotter tip.
        tip_max_c: f64 = 41.0, "°C", 20.0..=85.0, "41 for what touches a patient, more on a bench";
        /// Distance of the estimated bend from a constant set-point at which the gate trips. A larger value pushes a tip that
        /// does not follow further.
        following_deg: f64 = 20.0, "deg", 1.0..=90.0, "20 is well above what backlash and load make";
        /// Further distance per °/s of set-point speed. A larger value suits a slower line.
        following_s: f64 = 0.4, "s", 0.0..=5.0, "a little more than lag and dead time together";
        /// Time for which that distance may be exceeded. A larger value tolerates knocks and trips later.
        following_for_s: f64 = 0.5, "s", 0.01..=10.0, "0.5 tolerates a knock";
        /// Age of the last usable orientation at which the gate trips; the loop holds by itself well before. A larger value
        /// waits longer for a sensor that hangs.
        stale_s: f64 = 0.5, "s", 0.01..=10.0, "the loop holds by itself after 0.1 s";
        /// Time between two turns of the loop at which the gate trips. A larger value tolerates a worse scheduler.
        late_s: f64 = 0.05, "s", 0.002..=1.0, "50 loop periods of 1 ms";
        /// Piston speed of the return to rest. A larger value returns sooner.
        relax_mm_s: f64 = 8.0, "mm/s", 0.1..=100.0, "8 brings 20 mm of piston back in 3 s";
        /// Safe state of each cause: `hold` (brake and stand, energised: the tip keeps its bend), `relax` (brake, return to zero
        /// slowly, then release the drivers) or `release` (release the drivers at once: as `[power]` says, the tip goes soft and
        /// straight by its own air, and zero must be found again).
        on: SafeStates;
        /// Residual monitor: when a difference between predicted and estimated bend is reported.
        residual: ResidualConfig;
        /// Restart with a bent tip: when the tip counts as being where it was.
        restart: RestartCheckConfig;
    }
}

impl SafetySection {
    /// The gate's limits for a loop of this period.
    pub fn gate(&self, config: &LoopConfig, period_s: f64) -> GateLimits {
        let (motion, limits) = (&config.motion.limits, &config.limits);
        GateLimits {
            step_mm: config.drive.step_mm,
            tick_s: period_s,
            // half a step of rounding
            travel_mm: limits.travel_mm + config.drive.step_mm,
            speed_mm_s: motion.speed_max_mm_s * self.speed_share,
            acceleration_mm_s2: motion.acceleration_max_mm_s2 * self.acceleration_share,
            squeeze_mm: self.pressure_max_kpa / limits.pressure_kpa_per_mm,
            following_rad: self.following_deg.to_radians(),
            following_s: self.following_s,
            following_for_s: self.following_for_s,
            stale_s: self.stale_s,
            late_s: self.late_s.max(3.0 * period_s),
            react_s: config.motion.react_s(),
            rest_s: config.motion.rest_s(config.drive.step_mm),
            brake_mm_s2: motion.acceleration_max_mm_s2,
            relax_mm_s: self.relax_mm_s,
            on: self.on,
        }
    }
}
