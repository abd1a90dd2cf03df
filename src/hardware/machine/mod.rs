//! The machine made of hardware: step thread, IMU threads and input lines behind
//! [`crate::motion::machine::Machine`].
//!
//! ```text
//!  loop ──turn(now, wanted)──▶ Drive ─ Motion ─ ring ─▶ step thread ──▶ pins      position =
//!       ◀──────Sensed───────── Sensor ◀─ ring ── IMU thread ◀── I²C               steps pulsed
//! ```
//!
//! Sensors deliver uncorrected samples, rotated by the mount; the loop applies the calibration.
//!
//! No thread waits for another. A bus that hangs blocks only its own thread. The loop then receives no
//! reading, and the health monitor reacts.

mod error;
mod gauges;
mod reading;
mod sensor;

pub use error::HardwareError;
pub use gauges::GaugeConfig;
pub use sensor::{ImuSection, Sensor, slowness};

use crate::hardware::lock::HardwareLock;
use crate::hardware::pins::{self, PinsConfig};
use crate::hardware::rt::monotonic_ns;
use crate::hardware::stepper::Stepper;
use crate::motion::{
    Drive, DriveLimits, EmergencyStop, Machine, MachineError, MachineInfo, Sensed, StepGenerator,
    StepperConfig,
};
use crate::primitives::{ImuReading, Seconds, Steps};
use gauges::GaugeWatch;

/// Configuration of a machine made of hardware.
#[derive(Debug, Clone)]
pub struct MachineConfig {
    /// Name, loop period, microstep and rest length.
    pub info: MachineInfo,
    /// Microsteps per full step.
    pub microsteps: u32,
    /// Wiring.
    pub pins: PinsConfig,
    /// Pulses and their thread.
    pub stepper: StepperConfig,
    /// Reaction of the step thread to the emergency stop.
    pub emergency_stop: EmergencyStop,
    /// Limits of motion.
    pub motion: DriveLimits,
    /// IMU of the tip.
    pub imu: Option<ImuSection>,
    /// IMU of the base.
    pub base_imu: Option<ImuSection>,
    /// SCHED_FIFO priority of the threads that read them; 0 requests none.
    pub imu_priority: i32,
    /// Pressure sensors, and limits of pressure and temperature.
    pub gauges: GaugeConfig,
}

/// A machine with drivers that are pulsed and sensors that are read.
pub struct Hardware {
    drive: Drive<Stepper>,
    imu: Option<Sensor>,
    base_imu: Option<Sensor>,
    gauges: GaugeWatch,
    info: MachineInfo,
    /// Monotonic time at the loop's zero, ns; set by the first cycle.
    zero_ns: Option<u64>,
    /// Released last, when the step thread has ended.
    _lock: HardwareLock,
}

impl Hardware {
    /// Opens pins and sensors and starts their threads, with the drivers off and the pistons at zero.
    ///
    /// # Errors
    /// [`HardwareError`]. The sensors are opened first, so that nothing moves without them.
    pub fn open(config: &MachineConfig) -> Result<Self, HardwareError> {
        let lock = HardwareLock::take().map_err(HardwareError::InUse)?;
        let start = |section: &ImuSection| Sensor::start(section, config.imu_priority);
        let imu = config.imu.as_ref().map(start).transpose()?;
        let base_imu = config.base_imu.as_ref().map(start).transpose()?;
        let gauges = GaugeWatch::start(&config.gauges)?;
        let pins = pins::open(&config.pins, config.microsteps)?;
        let stepper = Stepper::start(
            pins,
            &config.stepper,
            &config.motion.limits,
            config.info.step_mm,
            config.emergency_stop,
        )?;
        let (step_mm, period_s) = (config.info.step_mm, config.info.period_s);
        let drive = Drive::new(stepper, &config.motion, step_mm, period_s);
        Ok(Self {
            drive,
            imu,
            base_imu,
            gauges,
            info: config.info.clone(),
            zero_ns: None,
            _lock: lock,
        })
    }
}

/// The newest reading of a sensor with its time on the loop's clock, and its temperature; readings from before the loop's
/// zero are at zero.
fn newest(sensor: &mut Option<Sensor>, zero_ns: u64) -> (ImuReading, Option<f64>) {
    let Some(mut newest) = sensor.as_mut().and_then(Sensor::newest) else {
        return (ImuReading::Nothing, None);
    };
    match &mut newest.reading {
        ImuReading::Sample(sample, _) => {
            sample.t = Seconds(newest.t_ns.saturating_sub(zero_ns) as f64 * 1e-9);
        }
        _ => newest.temp_c = None,
    }
    (newest.reading, newest.temp_c)
}

impl Machine for Hardware {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let now_ns = monotonic_ns();
        let since_zero_ns = (now.0 * 1e9) as u64;
        let zero_ns = *self
            .zero_ns
            .get_or_insert(now_ns.saturating_sub(since_zero_ns));
        self.drive.update(now_ns, wanted);
        let base_imu = match newest(&mut self.base_imu, zero_ns) {
            (ImuReading::Sample(sample, _), _) => Some(sample),
            _ => None,
        };
        let (imu, die_c) = newest(&mut self.imu, zero_ns);
        let (gauges, limit) = self.gauges.turn(now_ns, die_c);
        let steps = Sensed::of_drive(now, zero_ns + since_zero_ns, &self.drive);
        Ok(Sensed {
            imu,
            base_imu,
            gauges,
            alarm: steps.alarm.or(limit),
            ..steps
        })
    }

    fn energise(&mut self, on: bool) {
        self.drive.energise(on);
    }

    fn recount(&mut self, counted: &Steps) {
        self.drive.rebase(counted);
    }

    fn clear(&mut self) {
        self.drive.clear();
    }

    fn is_simulated(&self) -> bool {
        false
    }

    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        for (place, sensor) in [("tip", &self.imu), ("base", &self.base_imu)] {
            let Some(s) = sensor else { continue };
            let (chip, rate_hz) = (s.found.identity.inertial, s.found.identity.rate_hz);
            let slow = slowness(s.found.read_s, rate_hz);
            remarks.extend(slow.map(|slow| format!("{place} IMU: {slow}")));
            let limit = if s.found.bounded {
                ""
            } else {
                "; the bus driver accepts no time limit"
            };
            let bus = &s.bus;
            remarks.push(format!(
                "{place} IMU: {chip} on {bus}, {rate_hz:.1} Hz{limit}"
            ));
        }
        let stepper = self.drive.generator();
        let grants = stepper.status.iter();
        remarks.extend(grants.map(|(name, grant)| format!("step thread, {name}: {grant}")));
        if let Some(r) = stepper.latest() {
            if r.underruns > 0 {
                remarks.push(format!(
                    "{} underruns of the step queue: the loop did not run in time",
                    r.underruns
                ));
            }
            let [p999_us, max_us] =
                [r.lateness.quantile_ns(0.999), r.lateness.max_ns()].map(|ns| ns as f64 * 1e-3);
            remarks.push(format!(
                "step lateness {p999_us:.0} µs at p99.9, {max_us:.0} µs at most"
            ));
        }
        remarks.extend(stepper.pin_error().map(|error| format!("pins: {error}")));
        remarks
    }
}
