//! [`Machine`] on hardware.

use crate::estimation::fusion::health::ImuReading;
use crate::hardware::machine::drive::{Drive, DriveState};
use crate::hardware::machine::error::HardwareError;
use crate::hardware::machine::sensor::{Sensor, SensorConfig};
use crate::hardware::pins::{self, PinsConfig};
use crate::hardware::rt::monotonic_ns;
use crate::motion::lines::{EmergencyStop, Inputs};
use crate::motion::report::StepperFault;
use crate::motion::{MotionConfig, StepperConfig};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Seconds, Steps};
use crate::supervisor::machine::{Alarm, Machine, MachineError, MachineInfo, Sensed};

/// A single underrun is braked within the limits and motion resumes: no step is lost and no action is
/// needed. This number of underruns …
const UNDERRUNS: usize = 4;
/// … within this time, s, is an alarm.
const UNDERRUNS_WITHIN_S: f64 = 5.0;

/// Configuration of a machine made of hardware.
#[derive(Debug, Clone)]
pub struct MachineConfig {
    /// Name for reports.
    pub name: String,
    /// Period of the loop, s.
    pub period_s: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Microsteps per full step.
    pub microsteps: u32,
    /// Wiring.
    pub pins: PinsConfig,
    /// Pulses and their thread.
    pub stepper: StepperConfig,
    /// Reaction of the step thread to the emergency stop.
    pub emergency_stop: EmergencyStop,
    /// Limits of motion.
    pub motion: MotionConfig,
    /// IMU of the tip.
    pub imu: Option<SensorConfig>,
    /// IMU of the base.
    pub base_imu: Option<SensorConfig>,
}

/// A machine with drivers that are pulsed and sensors that are read.
pub struct Hardware {
    drive: Drive,
    imu: Option<Sensor>,
    base_imu: Option<Sensor>,
    info: MachineInfo,
    /// Monotonic time at the loop's zero, ns; set by the first cycle.
    zero_ns: Option<u64>,
    /// Number of underruns, and the times of the last ones, s, newest last.
    underruns: u32,
    underran_s: [f64; UNDERRUNS],
    underrun_alarm: bool,
}

impl Hardware {
    /// Opens pins and sensors and starts their threads, with the drivers off and the pistons at zero.
    ///
    /// # Errors
    /// [`HardwareError`]. The sensors are opened first, so that nothing moves without them.
    pub fn open(config: &MachineConfig) -> Result<Self, HardwareError> {
        let imu = config.imu.as_ref().map(Sensor::start).transpose()?;
        let base_imu = config.base_imu.as_ref().map(Sensor::start).transpose()?;
        let pins = pins::open(&config.pins, config.microsteps)?;
        let drive = Drive::start(pins, &config.stepper, &config.motion, config.step_mm, config.period_s, config.emergency_stop)?;
        let info = MachineInfo {
            name: config.name.clone(),
            period_s: config.period_s,
            step_mm: config.step_mm,
            rest_length_mm: config.rest_length_mm,
        };
        let underran_s = [f64::NEG_INFINITY; UNDERRUNS];
        Ok(Self { drive, imu, base_imu, info, zero_ns: None, underruns: 0, underran_s, underrun_alarm: false })
    }

    fn alarm(&self) -> Option<Alarm> {
        match self.drive.state() {
            DriveState::Faulted(StepperFault::Late { late_ns, .. }) => Some(Alarm::Late { late_s: late_ns as f64 * 1e-9 }),
            DriveState::Faulted(StepperFault::Discontinuity { jump_mm, .. }) => Some(Alarm::Discontinuity { jump_mm }),
            DriveState::Faulted(StepperFault::Pins) => Some(Alarm::Pins),
            DriveState::Dead => Some(Alarm::Dead),
            _ if self.underrun_alarm => Some(Alarm::Underrun),
            _ => None,
        }
    }

    /// Raises the alarm when underruns follow one another closely.
    fn watch_underruns(&mut self, now: Seconds, underruns: u32) {
        if underruns > self.underruns {
            self.underruns = underruns;
            self.underran_s.rotate_left(1);
            self.underran_s[UNDERRUNS - 1] = now.0;
            self.underrun_alarm |= now.0 - self.underran_s[0] < UNDERRUNS_WITHIN_S;
        }
    }
}

/// The newest reading of a sensor with its time on the loop's clock; readings from before the loop's
/// zero are at zero.
fn newest(sensor: &mut Option<Sensor>, zero_ns: u64) -> ImuReading {
    let Some(reading) = sensor.as_mut().and_then(Sensor::newest) else { return ImuReading::Nothing };
    match reading.reading {
        ImuReading::Sample(sample, quality) => {
            let t = Seconds(reading.t_ns.saturating_sub(zero_ns) as f64 * 1e-9);
            ImuReading::Sample(ImuSample { t, ..sample }, quality)
        }
        other => other,
    }
}

impl Machine for Hardware {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let now_ns = monotonic_ns();
        let zero_ns = *self.zero_ns.get_or_insert_with(|| now_ns.saturating_sub((now.0 * 1e9) as u64));
        let state = self.drive.update(now_ns, wanted.0.map(|n| f64::from(n) * self.info.step_mm));
        let base_imu = match newest(&mut self.base_imu, zero_ns) {
            ImuReading::Sample(sample, _) => Some(sample),
            _ => None,
        };
        let imu = newest(&mut self.imu, zero_ns);
        let (mut counted, mut inputs) = (Steps::default(), Inputs::default());
        if let Some(&report) = self.drive.stepper().latest() {
            (counted, inputs) = (report.counted, report.inputs);
            inputs.emergency_stop |= state == DriveState::Faulted(StepperFault::EmergencyStop);
            self.watch_underruns(now, report.underruns);
        }
        let energised = self.drive.stepper().is_energised();
        Ok(Sensed { t: now, imu, base_imu, counted, energised, inputs, alarm: self.alarm(), truth: None })
    }

    fn energise(&mut self, on: bool) {
        self.drive.energise(on);
    }

    fn recount(&mut self, counted: &Steps) {
        self.drive.rebase(counted);
    }

    fn clear(&mut self) {
        self.underrun_alarm = false;
        self.drive.clear();
    }

    fn is_simulated(&self) -> bool {
        false
    }

    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        for (place, sensor) in [("tip", &self.imu), ("base", &self.base_imu)] {
            if let Some(s) = sensor {
                let i = s.identity();
                let (chip, limit) = (i.inertial, if s.is_bounded() { "" } else { "; the bus driver accepts no time limit" });
                remarks.push(format!("{place} IMU: {} at {:#04x} on {}, {:.1} Hz{limit}", chip.part, chip.address, s.bus(), i.rate_hz));
            }
        }
        let stepper = self.drive.stepper();
        remarks.extend(stepper.status().iter().map(|(name, grant)| format!("step thread, {name}: {grant}")));
        if self.underruns > 0 {
            remarks.push(format!("{} underruns of the step queue: the loop did not run in time", self.underruns));
        }
        if let Some(r) = stepper.latest() {
            let (p999_us, max_us) = (r.lateness.quantile_ns(0.999) as f64 * 1e-3, r.lateness.max_ns() as f64 * 1e-3);
            remarks.push(format!("step lateness {p999_us:.0} µs at p99.9, {max_us:.0} µs at most"));
        }
        remarks.extend(stepper.pin_error().map(|error| format!("pins: {error}")));
        remarks
    }
}
