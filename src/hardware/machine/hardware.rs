//! [`Machine`] on hardware.

use crate::estimation::fusion::health::ImuReading;
use crate::hardware::machine::{Drive, DriveState, HardwareError, MachineConfig, Sensor};
use crate::hardware::pins;
use crate::hardware::rt::monotonic_ns;
use crate::motion::lines::Inputs;
use crate::motion::report::StepperFault;
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Seconds, Steps};
use crate::supervisor::machine::{Alarm, Machine, Sensed};
use crate::supervisor::machine::{MachineError, MachineInfo};

/// A queue that runs dry once is braked within the limits and taken up again: no step is lost and nothing
/// needs to be done. This often …
const STARVED_TIMES: usize = 4;
/// … within this time, s, it is an alarm.
const STARVED_WITHIN_S: f64 = 5.0;

/// Pistons that are pulsed and sensors that are read.
pub struct Hardware {
    drive: Drive,
    imu: Option<Sensor>,
    base_imu: Option<Sensor>,
    info: MachineInfo,
    /// Monotonic time at the loop's zero, ns; set by the first turn.
    zero_ns: Option<u64>,
    /// How often the queue ran dry.
    dry: u32,
    /// When it did so, the newest last, s.
    dried_s: [f64; STARVED_TIMES],
    starved: bool,
}

impl Hardware {
    /// Opens pins and sensors and starts their threads; drivers off, pistons called zero.
    ///
    /// # Errors
    /// [`HardwareError`]; sensors are tried first, so that nothing is driven blind.
    pub fn open(config: &MachineConfig) -> Result<Self, HardwareError> {
        let imu = config.imu.as_ref().map(Sensor::start).transpose()?;
        let base_imu = config.base_imu.as_ref().map(Sensor::start).transpose()?;
        let pins = pins::open(&config.pins, config.microsteps)?;
        let drive = Drive::start(pins, &config.stepper, &config.motion, config.step_mm, config.period_s)?;
        let info = MachineInfo {
            name: config.name.clone(),
            period_s: config.period_s,
            step_mm: config.step_mm,
            rest_length_mm: config.rest_length_mm,
        };
        Ok(Self { drive, imu, base_imu, info, zero_ns: None, dry: 0, dried_s: [f64::NEG_INFINITY; STARVED_TIMES], starved: false })
    }

    /// The motion side.
    #[must_use]
    pub fn drive(&self) -> &Drive {
        &self.drive
    }

    fn alarm(&self) -> Option<Alarm> {
        match self.drive.state() {
            DriveState::Faulted(StepperFault::Late { late_ns, .. }) => Some(Alarm::Late { late_s: late_ns as f64 * 1e-9 }),
            DriveState::Faulted(StepperFault::Discontinuity { jump_mm, .. }) => Some(Alarm::Discontinuity { jump_mm }),
            DriveState::Faulted(StepperFault::Pins) => Some(Alarm::Pins),
            DriveState::Dead => Some(Alarm::Dead),
            _ if self.starved => Some(Alarm::Underrun),
            _ => None,
        }
    }
}

/// A stamp on the loop's clock; what was read before its zero is at zero.
fn on_loop_clock(t_ns: u64, zero_ns: u64) -> Seconds {
    Seconds(t_ns.saturating_sub(zero_ns) as f64 * 1e-9)
}

impl Machine for Hardware {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let now_ns = monotonic_ns();
        let zero_ns = *self.zero_ns.get_or_insert_with(|| now_ns.saturating_sub((now.0 * 1e9) as u64));
        let target_mm = wanted.0.map(|n| f64::from(n) * self.info.step_mm);
        let state = self.drive.turn(now_ns, target_mm);
        let stamped = |s: &mut Sensor| {
            s.newest().map(|r| match r.outcome {
                ImuReading::Sample(sample, quality) => {
                    ImuReading::Sample(ImuSample { t: on_loop_clock(r.t_ns, zero_ns), ..sample }, quality)
                }
                other => other,
            })
        };
        let base_imu = self.base_imu.as_mut().and_then(stamped).and_then(|o| if let ImuReading::Sample(s, _) = o { Some(s) } else { None });
        let imu = self.imu.as_mut().and_then(stamped).unwrap_or(ImuReading::Nothing);
        let report = self.drive.report();
        if let Some(dry) = report.map(|r| r.dry).filter(|d| *d > self.dry) {
            self.dry = dry;
            self.dried_s.rotate_left(1);
            self.dried_s[STARVED_TIMES - 1] = now.0;
            self.starved |= now.0 - self.dried_s[0] < STARVED_WITHIN_S;
        }
        let pressed = state == DriveState::Faulted(StepperFault::EmergencyStop);
        Ok(Sensed {
            t: now,
            imu,
            base_imu,
            counted: report.map_or(Steps::default(), |r| r.counted),
            energised: self.drive.stepper().is_energised(),
            inputs: report.map_or(Inputs::default(), |r| Inputs { emergency_stop: r.inputs.emergency_stop || pressed, ..r.inputs }),
            alarm: self.alarm(),
            truth: None,
        })
    }

    fn energise(&mut self, on: bool) {
        self.drive.energise(on);
    }

    fn recount(&mut self, counted: &Steps) {
        self.drive.rebase(counted);
    }

    fn clear(&mut self) {
        self.starved = false;
        self.drive.clear();
    }

    fn is_simulated(&self) -> bool {
        false
    }

    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        for (what, sensor) in [("tip", &self.imu), ("base", &self.base_imu)] {
            if let Some(s) = sensor {
                let i = s.identity();
                remarks.push(format!("{what} IMU: {} at {:#04x} on {}, {:.1} Hz", i.inertial.part, i.inertial.address, s.bus(), i.rate_hz));
            }
        }
        for (name, grant) in self.drive.stepper().status().rows() {
            remarks.push(format!("step thread, {name}: {grant}"));
        }
        if self.dry > 0 {
            remarks.push(format!("the queue of motion ran dry {} times: the loop was kept from running", self.dry));
        }
        if let Some(r) = self.drive.report() {
            let (p999_us, max_us) = (r.lateness.quantile_ns(0.999) as f64 * 1e-3, r.lateness.max_ns() as f64 * 1e-3);
            remarks.push(format!("steps late by {p999_us:.0} µs at p99.9, {max_us:.0} µs at most"));
        }
        remarks.extend(self.drive.stepper().pin_words().map(|w| format!("pins: {w}")));
        remarks
    }
}
