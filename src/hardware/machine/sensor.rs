//! One IMU in a thread of its own: opens the bus, sets the chip up, reads it at its rate, and sets it up
//! anew when it has restarted or gone silent.
//!
//! Readings go through a wait-free ring with the time at which the transfer began. A transfer that never
//! returns keeps this thread and nothing else.

use crate::estimation::fusion::health::ImuReading;
use crate::estimation::imu_calibration::{Correction, ImuCalibration};
use crate::hardware::imu::{self, Identity, Imu, ImuConfig, ImuError};
use crate::hardware::machine::HardwareError;
use crate::hardware::rt::{self, RtRequest, RtStatus};
use crate::primitives::units::Seconds;
use embedded_hal::delay::DelayNs;
use nalgebra::UnitQuaternion;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender};
use std::time::Duration;

/// Longest time from opening the bus to a chip that is set up, s.
const SETUP_MAX_S: f64 = 5.0;
/// Readings the ring holds: at 500 Hz an eighth of a second.
const READINGS: usize = 64;
/// Failed readings in a row after which the chip is set up anew.
const FAILURES_MAX: u32 = 25;
/// Time between two attempts to set the chip up, ns.
const RETRY_NS: u64 = 250_000_000;

/// What a sensor is made from.
#[derive(Debug, Clone)]
pub struct SensorConfig {
    /// Device file of the bus.
    pub bus: String,
    /// Through `rppal` instead of `linux-embedded-hal`.
    pub rppal: bool,
    /// Sensor to tip (or base).
    pub mount: UnitQuaternion<f64>,
    /// The part.
    pub chip: ImuConfig,
    /// Readings a second.
    pub rate_hz: f64,
    /// SCHED_FIFO priority of the thread; 0 asks for none.
    pub priority: i32,
}

/// A reading and when its transfer began, ns of the monotonic clock.
#[derive(Debug, Clone, Copy)]
pub struct Stamped {
    /// When.
    pub t_ns: u64,
    /// What; the stamp inside a sample is not set yet.
    pub outcome: ImuReading,
}

/// The loop's handle on the thread.
#[derive(Debug)]
pub struct Sensor {
    readings: rtrb::Consumer<Stamped>,
    stop: Arc<AtomicBool>,
    identity: Identity,
    status: RtStatus,
    bus: String,
}

/// Waiting for a chip, by sleeping.
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
    /// [`HardwareError`]: no bus, no permission, a chip that does not answer, is another or never comes up.
    pub fn start(config: &SensorConfig) -> Result<Self, HardwareError> {
        let (to, readings) = rtrb::RingBuffer::new(READINGS);
        let stop = Arc::new(AtomicBool::new(false));
        let (tell, told) = std::sync::mpsc::channel();
        let mut reader = Reader {
            config: config.clone(),
            correction: ImuCalibration::default().correction(),
            to,
            stop: stop.clone(),
            failures: 0,
            retry_ns: 0,
        };
        std::thread::Builder::new().name("imu".into()).spawn(move || reader.run(&tell))?;
        let limit_s = SETUP_MAX_S;
        match told.recv_timeout(Duration::from_secs_f64(limit_s)) {
            Ok(Ok((identity, status))) => Ok(Self { readings, stop, identity, status, bus: config.bus.clone() }),
            Ok(Err(error)) => Err(error),
            Err(RecvTimeoutError::Timeout) => {
                stop.store(true, Ordering::Relaxed);
                Err(HardwareError::BusHangs { path: config.bus.clone(), limit_s })
            }
            Err(RecvTimeoutError::Disconnected) => {
                Err(HardwareError::Bus { path: config.bus.clone(), why: "the IMU thread died as it started".to_owned() })
            }
        }
    }

    /// The newest reading not handed over yet, a failed one too.
    pub fn newest(&mut self) -> Option<Stamped> {
        let mut newest = None;
        while let Ok(next) = self.readings.pop() {
            newest = Some(next);
        }
        newest
    }

    /// What was found and set.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// What the kernel granted the thread.
    #[must_use]
    pub fn status(&self) -> &RtStatus {
        &self.status
    }

    /// The bus it is on.
    #[must_use]
    pub fn bus(&self) -> &str {
        &self.bus
    }
}

impl Drop for Sensor {
    /// Tells the thread to end. It is not waited for: its bus may hang.
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

type Started = Result<(Identity, RtStatus), HardwareError>;

/// The thread's side.
struct Reader {
    config: SensorConfig,
    correction: Correction,
    to: rtrb::Producer<Stamped>,
    stop: Arc<AtomicBool>,
    failures: u32,
    retry_ns: u64,
}

impl Reader {
    fn run(&mut self, tell: &Sender<Started>) {
        let wish = RtRequest { priority: self.config.priority, cpu: None };
        let begun = open(&self.config).and_then(|mut chip| {
            let identity = chip.init(&mut Sleep).map_err(|source| HardwareError::Imu { path: self.config.bus.clone(), source })?;
            Ok((chip, identity))
        });
        let mut chip = match begun {
            Ok((chip, identity)) => {
                let (status, _guard) = rt::enter(&wish);
                // the starter may have given up waiting; then `stop` is set
                let _ = tell.send(Ok((identity, status)));
                chip
            }
            Err(error) => {
                let _ = tell.send(Err(error));
                return;
            }
        };
        let period_ns = (1e9 / self.config.rate_hz) as u64;
        let mut next_ns = rt::monotonic_ns();
        while !self.stop.load(Ordering::Relaxed) && !self.to.is_abandoned() {
            self.turn(chip.as_mut());
            let now_ns = rt::monotonic_ns();
            next_ns += period_ns;
            if next_ns < now_ns {
                next_ns = now_ns; // a slow transfer is not made up for
            }
            rt::sleep_until_ns(next_ns);
        }
    }

    /// One reading; after too many bad ones, or a restart, the chip is set up anew.
    fn turn(&mut self, chip: &mut (dyn Imu + Send)) {
        let t_ns = rt::monotonic_ns();
        let result = chip.read();
        let restart = matches!(result, Err(ImuError::ResetToDefaults { .. } | ImuError::NotReady { .. }));
        self.failures = if result.is_ok() { 0 } else { self.failures + 1 };
        let mut outcome = imu::outcome(&result, &chip.scale(), &self.correction, Seconds(0.0));
        if let ImuReading::Sample(sample, _) = &mut outcome {
            sample.gyro_rad_s = self.config.mount * sample.gyro_rad_s;
            sample.acc_m_s2 = self.config.mount * sample.acc_m_s2;
            sample.mag_ut = sample.mag_ut.map(|m| self.config.mount * m);
        }
        // a full ring means that the loop is stuck; what it will read then is old anyway
        let _ = self.to.push(Stamped { t_ns, outcome });
        if (restart || self.failures >= FAILURES_MAX) && t_ns >= self.retry_ns {
            // what it says is the outcome of the next reading
            let _ = chip.init(&mut Sleep);
            self.failures = 0;
            self.retry_ns = rt::monotonic_ns() + RETRY_NS;
        }
    }
}

/// The driver on its bus.
#[cfg(feature = "hw")]
fn open(config: &SensorConfig) -> Result<Box<dyn Imu + Send>, HardwareError> {
    use crate::hardware::imu::linux::Classified;
    let path = config.bus.clone();
    // the libraries fold the reasons; the file itself tells them apart
    if let Err(e) = std::fs::File::options().read(true).write(true).open(&path) {
        return Err(match e.kind() {
            std::io::ErrorKind::NotFound => HardwareError::NoBus { path },
            std::io::ErrorKind::PermissionDenied => HardwareError::BusPermission { path },
            _ => HardwareError::Bus { path, why: e.to_string() },
        });
    }
    if config.rppal {
        let number = path.strip_prefix("/dev/i2c-").and_then(|n| n.parse().ok());
        let bus = match number {
            Some(n) => rppal::i2c::I2c::with_bus(n).map_err(|e| HardwareError::Bus { path, why: e.to_string() })?,
            None => return Err(HardwareError::Bus { path, why: "rppal wants /dev/i2c-N".to_owned() }),
        };
        return Ok(imu::open(&config.chip, Classified(bus))?);
    }
    let bus = linux_embedded_hal::I2cdev::new(&path).map_err(|e| HardwareError::Bus { path, why: e.to_string() })?;
    Ok(imu::open(&config.chip, Classified(bus))?)
}

#[cfg(not(feature = "hw"))]
fn open(_: &SensorConfig) -> Result<Box<dyn Imu + Send>, HardwareError> {
    Err(HardwareError::NotBuilt)
}
