//! One IMU in a thread of its own, which opens the bus and reads the sensor at its rate.
//!
//! Readings travel through a wait-free ring with the time at which their transfer began. A transfer that
//! never returns blocks only this thread. [`ImuRecovery`] sets the chip up again after a restart or a
//! series of failures.

use crate::estimation::fusion::health::ImuReading;
use crate::hardware::imu::{self, ChipConfig, Identity, Imu, ImuRecovery};
use crate::hardware::machine::error::HardwareError;
use crate::hardware::rt::{self, RtRequest, monotonic_ns};
use crate::primitives::units::Seconds;
use embedded_hal::delay::DelayNs;
use nalgebra::UnitQuaternion;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Longest time from opening the bus to a configured chip, s. The slowest part takes half a second.
const SETUP_MAX_S: f64 = 5.0;
/// Capacity of the ring: an eighth of a second at 500 Hz.
const READINGS: usize = 64;

/// Configuration of a sensor.
#[derive(Debug, Clone)]
pub struct SensorConfig {
    /// Device file of the bus.
    pub bus: String,
    /// Use `rppal` instead of `linux-embedded-hal`.
    pub rppal: bool,
    /// Rotation from sensor to tip (or base).
    pub mount: UnitQuaternion<f64>,
    /// The part and its settings.
    pub chip: ChipConfig,
    /// Readings per second.
    pub rate_hz: f64,
    /// SCHED_FIFO priority of the thread; 0 requests none.
    pub priority: i32,
}

/// A reading with the start of its transfer, ns of the monotonic clock.
#[derive(Debug, Clone, Copy)]
pub struct StampedReading {
    /// Start of the transfer.
    pub t_ns: u64,
    /// The reading; the time inside a sample is not set.
    pub reading: ImuReading,
}

/// The loop's handle on the thread.
#[derive(Debug)]
pub struct Sensor {
    readings: rtrb::Consumer<StampedReading>,
    stop: Arc<AtomicBool>,
    identity: Identity,
    bus: String,
}

/// Delays by sleeping.
struct Sleep;

impl DelayNs for Sleep {
    fn delay_ns(&mut self, ns: u32) {
        std::thread::sleep(Duration::from_nanos(u64::from(ns)));
    }
}

impl Sensor {
    /// Opens the bus, sets the chip up and starts reading.
    ///
    /// # Errors
    /// [`HardwareError`]: no bus, no permission, or a chip that does not answer, is another part or does
    /// not start.
    pub fn start(config: &SensorConfig) -> Result<Self, HardwareError> {
        let (output, readings) = rtrb::RingBuffer::new(READINGS);
        let stop = Arc::new(AtomicBool::new(false));
        let (sender, receiver) = channel();
        let (own, end) = (config.clone(), stop.clone());
        std::thread::Builder::new().name("imu".into()).spawn(move || run(&own, output, &end, &sender))?;
        let path = config.bus.clone();
        match receiver.recv_timeout(Duration::from_secs_f64(SETUP_MAX_S)) {
            Ok(result) => Ok(Self { readings, stop, identity: result?, bus: path }),
            Err(RecvTimeoutError::Timeout) => {
                stop.store(true, Ordering::Relaxed);
                Err(HardwareError::BusHangs { path, limit_s: SETUP_MAX_S })
            }
            Err(RecvTimeoutError::Disconnected) => Err(HardwareError::Bus { path, why: "the IMU thread ended as it started".to_owned() }),
        }
    }

    /// The newest reading since the last call, including failed ones.
    pub fn newest(&mut self) -> Option<StampedReading> {
        std::iter::from_fn(|| self.readings.pop().ok()).last()
    }

    /// The chips that were found and their rates.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Device file of the bus.
    #[must_use]
    pub fn bus(&self) -> &str {
        &self.bus
    }
}

impl Drop for Sensor {
    /// Tells the thread to end without waiting for it, because its bus may hang.
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// The thread: reports the result of the set-up, then reads until `stop` or until the handle is dropped.
fn run(
    config: &SensorConfig,
    mut output: rtrb::Producer<StampedReading>,
    stop: &AtomicBool,
    started: &Sender<Result<Identity, HardwareError>>,
) {
    let set_up = open(config).and_then(|driver| {
        let mut imu = ImuRecovery::new(driver);
        let identity = imu.start(&mut Sleep).map_err(|source| HardwareError::Imu { path: config.bus.clone(), source })?;
        Ok((imu, identity))
    });
    let (mut imu, identity) = match set_up {
        Ok(ready) => ready,
        Err(error) => {
            let _ = started.send(Err(error));
            return;
        }
    };
    let _guard = rt::enter(&RtRequest { priority: config.priority, cpu: None });
    // The receiver may have timed out; then `stop` is set.
    let _ = started.send(Ok(identity));
    let period_ns = (1e9 / config.rate_hz) as u64;
    let mut next_ns = monotonic_ns();
    while !stop.load(Ordering::Relaxed) && !output.is_abandoned() {
        let t_ns = monotonic_ns();
        let mut reading = imu.read(&mut Sleep, Seconds(t_ns as f64 * 1e-9));
        if let ImuReading::Sample(sample, _) = &mut reading {
            sample.gyro_rad_s = config.mount * sample.gyro_rad_s;
            sample.acc_m_s2 = config.mount * sample.acc_m_s2;
            sample.mag_ut = sample.mag_ut.map(|m| config.mount * m);
        }
        // A full ring means that the loop is stuck, and this reading will be outdated when it resumes.
        let _ = output.push(StampedReading { t_ns, reading });
        // After a slow transfer the missed readings are not made up for.
        next_ns = (next_ns + period_ns).max(monotonic_ns());
        rt::sleep_until_ns(next_ns);
    }
}

/// The driver on its bus.
#[cfg(feature = "hw")]
fn open(config: &SensorConfig) -> Result<Box<dyn Imu + Send>, HardwareError> {
    use crate::hardware::imu::linux::Classified;
    let path = config.bus.clone();
    // The libraries merge the causes of a failure; opening the file here distinguishes them.
    if let Err(e) = std::fs::File::options().read(true).write(true).open(&path) {
        return Err(match e.kind() {
            std::io::ErrorKind::NotFound => HardwareError::NoBus { path },
            std::io::ErrorKind::PermissionDenied => HardwareError::BusPermission { path },
            _ => HardwareError::Bus { path, why: e.to_string() },
        });
    }
    if config.rppal {
        let Some(number) = path.strip_prefix("/dev/i2c-").and_then(|n| n.parse().ok()) else {
            return Err(HardwareError::Bus { path, why: "rppal requires a path of the form /dev/i2c-N".to_owned() });
        };
        let bus = rppal::i2c::I2c::with_bus(number).map_err(|e| HardwareError::Bus { path, why: e.to_string() })?;
        return Ok(imu::open(&config.chip, Classified(bus))?);
    }
    let bus = linux_embedded_hal::I2cdev::new(&path).map_err(|e| HardwareError::Bus { path, why: e.to_string() })?;
    Ok(imu::open(&config.chip, Classified(bus))?)
}

#[cfg(not(feature = "hw"))]
fn open(_: &SensorConfig) -> Result<Box<dyn Imu + Send>, HardwareError> {
    Err(HardwareError::NotBuilt)
}
