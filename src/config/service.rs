//! `[service]` and `[safety]` of a board file: who may command, and what is safe.

use crate::control::limits;
use crate::control::tick::LoopConfig;
use crate::primitives::check::Checker;
use crate::supervisor::cycle::restart_check::RestartCheckConfig;
use crate::supervisor::gate::{GateLimits, SafeStates};
use crate::supervisor::residual_monitor::ResidualConfig;
use serde::Deserialize;
use std::path::PathBuf;

/// `[service]`: the socket, the state folder, the loop's thread.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServiceSection {
    /// Socket for commands. Default `/run/retroflex/control.sock`; who may connect may command, so its
    /// folder and group decide. There is no network port.
    pub socket: PathBuf,
    /// Socket for reading status only. Default `/run/retroflex/status.sock`, open to everybody.
    pub status_socket: PathBuf,
    /// Permission bits of the command socket. Default 0o660: owner and group.
    pub socket_mode: u32,
    /// Permission bits of the status socket. Default 0o666.
    pub status_mode: u32,
    /// Folder of what must survive a restart. Default `/var/lib/retroflex`.
    pub state: PathBuf,
    /// A stream of set-points that is silent for this long has ended, and the tip stops, s. Default
    /// 0.25. Larger tolerates a slower sender, and lets the tip run on for longer without one.
    pub dead_man_s: f64,
    /// SCHED_FIFO priority of the loop, 1 to 99. Default 70: below the step thread. 0 asks for none.
    pub priority: i32,
    /// Processor the loop stays on. Left out (default): any.
    pub cpu: Option<usize>,
    /// How often where the pistons stand is written to disk while armed, s. Default 0.2. Smaller
    /// knows better after a power cut, and wears the card.
    pub checkpoint_s: f64,
}

impl Default for ServiceSection {
    fn default() -> Self {
        Self {
            socket: "/run/retroflex/control.sock".into(),
            status_socket: "/run/retroflex/status.sock".into(),
            socket_mode: 0o660,
            status_mode: 0o666,
            state: "/var/lib/retroflex".into(),
            dead_man_s: 0.25,
            priority: 70,
            cpu: None,
            checkpoint_s: 0.2,
        }
    }
}

/// `[safety]`: the gate between controller and step generator. Travel, speed, acceleration and
/// pressure come from `[limits]` and `[motion]`; what stands here is by how much the gate lets the
/// controller come near them, and everything else it watches.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SafetySection {
    /// Speed at which the gate trips, as a multiple of `motion.speed_max_mm_s`. Default 1.15. Larger
    /// trips later.
    pub speed_share: f64,
    /// Acceleration at which the gate trips, as a multiple of `motion.acceleration_max_mm_s2`.
    /// Default 2: the gate sees counts over 16 ticks, whose grain it cannot tell from a jerk.
    pub acceleration_share: f64,
    /// Pressure at which the gate trips, kPa. Default 41.3, the paper's 6 PSI. Larger risks the bellow.
    pub pressure_max_kpa: f64,
    /// Distance of the felt bend from the set-point at rest at which the gate trips, degrees. Default
    /// 20. Larger lets a tip that does not come be pushed further.
    pub following_deg: f64,
    /// More of it per °/s of set-point speed, s. Default 0.4. Larger suits a slower line.
    pub following_s: f64,
    /// How long it may last, s. Default 0.5. Larger forgives knocks and trips later.
    pub following_for_s: f64,
    /// Age of the last usable orientation at which the gate trips, s. Default 0.5; the loop holds by
    /// itself well before. Larger waits longer for a sensor that hangs.
    pub stale_s: f64,
    /// Time between two ticks at which the gate trips, s. Default 0.05. Larger tolerates a worse
    /// scheduler.
    pub late_s: f64,
    /// Speed of the way back to rest, mm/s. Default 8. Larger is back sooner.
    pub relax_mm_s: f64,
    /// The safe state of each cause: `hold` (brake and stand, energised), `relax` (brake, back to zero
    /// slowly, release) or `release` (drivers off at once).
    pub on: SafeStates,
    /// Words for a fault.
    pub explain: ResidualConfig,
    /// Proof after a restart.
    pub proof: RestartCheckConfig,
}

impl Default for SafetySection {
    fn default() -> Self {
        Self {
            speed_share: 1.15,
            acceleration_share: 2.0,
            pressure_max_kpa: 41.3,
            following_deg: 20.0,
            following_s: 0.4,
            following_for_s: 0.5,
            stale_s: 0.5,
            late_s: 0.05,
            relax_mm_s: 8.0,
            on: SafeStates::default(),
            explain: ResidualConfig::default(),
            proof: RestartCheckConfig::default(),
        }
    }
}

impl SafetySection {
    /// The gate's limits for a loop of this period.
    #[must_use]
    pub fn gate(&self, config: &LoopConfig, limits: &limits::ActuatorLimits, period_s: f64) -> GateLimits {
        let pace = &config.piston_pace;
        GateLimits {
            step_mm: config.drive.step_mm,
            tick_s: period_s,
            // half a step of rounding
            travel_mm: limits.travel_mm + config.drive.step_mm,
            speed_mm_s: pace.speed * self.speed_share,
            acceleration_mm_s2: pace.acceleration * self.acceleration_share,
            squeeze_mm: self.pressure_max_kpa / limits.pressure_kpa_per_mm,
            following_rad: self.following_deg.to_radians(),
            following_s: self.following_s,
            following_for_s: self.following_for_s,
            stale_s: self.stale_s,
            late_s: self.late_s.max(3.0 * period_s),
            brake_mm_s2: pace.acceleration,
            relax_mm_s: self.relax_mm_s,
            on: self.on,
        }
    }

    /// Says what is out of range.
    pub fn check(&self, to: &mut Checker) {
        let rows = [
            ("speed_share", self.speed_share, 1.0, 3.0, "", "1.15 leaves room for rounding"),
            ("acceleration_share", self.acceleration_share, 1.0, 20.0, "", "2 leaves room for the grain of microsteps"),
            ("pressure_max_kpa", self.pressure_max_kpa, 1.0, 200.0, "kPa", "the paper stays under 6 PSI = 41.4 kPa"),
            ("following_deg", self.following_deg, 1.0, 90.0, "degrees", "20 is well above what backlash and load make"),
            ("following_s", self.following_s, 0.0, 5.0, "s", "a little more than lag and dead time together"),
            ("following_for_s", self.following_for_s, 0.01, 10.0, "s", "0.5 forgives a knock"),
            ("stale_s", self.stale_s, 0.01, 10.0, "s", "the loop holds by itself after 0.1 s"),
            ("late_s", self.late_s, 0.002, 1.0, "s", "50 loop periods of 1 ms"),
            ("relax_mm_s", self.relax_mm_s, 0.1, 100.0, "mm/s", "8 brings 20 mm of piston back in 3 s"),
            ("explain.rest_deg", self.explain.rest_deg, 0.2, 45.0, "degrees", "4.5 is above what creep makes"),
            ("explain.motion_deg", self.explain.motion_deg, 0.2, 90.0, "degrees", "10 is above what backlash and lag make"),
            ("explain.share", self.explain.share, 0.0, 2.0, "", "0.22 is above what gains are off by"),
            ("explain.for_s", self.explain.for_s, 0.0, 10.0, "s", "0.1 overlooks a knock"),
            ("explain.leap_deg", self.explain.leap_deg, 0.2, 90.0, "degrees", "3.5 is above what a motion makes"),
            ("proof.gravity_deg", self.proof.gravity_deg, 0.1, 45.0, "degrees", "a few degrees"),
            ("proof.field_deg", self.proof.field_deg, 0.1, 90.0, "degrees", "some degrees more than gravity"),
        ];
        for (key, value, low, high, unit, mend) in rows {
            to.range(&format!("safety.{key}"), value, low..=high, unit, mend);
        }
    }
}

impl ServiceSection {
    /// Says what is out of range.
    pub fn check(&self, to: &mut Checker) {
        to.range("service.dead_man_s", self.dead_man_s, 0.02..=5.0, "s", "a few periods of the sender");
        to.range("service.priority", f64::from(self.priority), 0.0..=99.0, "", "70 is below the step thread; 0 asks for none");
        to.range("service.checkpoint_s", self.checkpoint_s, 0.02..=60.0, "s", "0.2 is 5 writes a second while armed");
        for (key, bits) in [("service.socket_mode", self.socket_mode), ("service.status_mode", self.status_mode)] {
            to.holds(key, bits <= 0o777, &format!("{bits:#o} is no set of permission bits"), "write it in octal, such as 0o660");
        }
        let same = self.socket == self.status_socket;
        to.holds("service.status_socket", !same, "the status socket is the command socket", "give each its own path");
    }
}
