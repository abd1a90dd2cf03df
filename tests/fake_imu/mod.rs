//! Register-level fakes of the sensors, on a bus with faults on request.
//!
//! A fake is a register machine that takes written bytes, returns read bytes and advances in time. [`FakeBus`] puts it
//! behind `embedded_hal::i2c::I2c` for drivers in the same process; a server of a bus file passes raw messages to
//! [`Machine`]. Each fake receives the true motion in SI units and sensor axes, converts at its configured rates, and
//! quantises to its configured ranges. Before it is woken and configured it does not convert, like the real chip.
//!
//! Filters are not modelled: a conversion is the motion of that instant plus white noise. Transfers take no time;
//! [`Machine::bus_time_s`] returns what they would take.
#![allow(
    dead_code,
    unused_imports,
    reason = "every test uses its own part of this"
)]

mod ak09916;
mod icm20948;
mod lis2mdl;
mod lsm6dso;
mod pressure;

pub use ak09916::FakeAk09916;
pub use icm20948::FakeIcm20948;
pub use lis2mdl::FakeLis2mdl;
pub use lsm6dso::FakeLsm6dso;
pub use pressure::FakePressure;

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use retroflex::hardware::imu::Axes;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The true motion of the sensor, in the accelerometer's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Specific force, m/s²: +9.81 on the axis that points up when still.
    pub acc_m_s2: Vector3<f64>,
    /// Angular rate, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Magnetic field, µT.
    pub mag_ut: Vector3<f64>,
    /// Die temperature, °C.
    pub temp_c: f64,
}

impl Default for Motion {
    /// Flat and still in a central European field.
    fn default() -> Self {
        Self {
            acc_m_s2: Vector3::new(0.0, 0.0, 9.81),
            gyro_rad_s: Vector3::zeros(),
            mag_ut: Vector3::new(20.0, 0.0, -45.0),
            temp_c: 25.0,
        }
    }
}

/// The field in the axes of a magnetometer that is mounted like `axes`: the inverse of [`Axes::to_frame`].
fn to_chip(axes: &Axes, frame: &Vector3<f64>) -> Vector3<f64> {
    Vector3::from_fn(|i, _| axes.to_frame(&Vector3::ith(i, 1.0)).dot(frame))
}

/// White noise of a conversion, one sigma per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// rad/s.
    pub gyro_rad_s: f64,
    /// m/s².
    pub acc_m_s2: f64,
    /// µT.
    pub mag_ut: f64,
}

impl Noise {
    /// None at all: readings are the quantised truth.
    pub const NONE: Self = Self {
        gyro_rad_s: 0.0,
        acc_m_s2: 0.0,
        mag_ut: 0.0,
    };
    /// Typical for these parts at some 100 Hz of bandwidth: 0.015 °/s/√Hz, 230 µg/√Hz, 0.5 µT.
    pub const TYPICAL: Self = Self {
        gyro_rad_s: 0.0029,
        acc_m_s2: 0.025,
        mag_ut: 0.5,
    };
}

/// Faults of one chip.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Quirks {
    /// Answers with this identity.
    pub wrong_id: Option<u8>,
    /// Answers, but does not convert.
    pub frozen: bool,
    /// The next conversion has these counts on every inertial axis, the one after it is normal.
    pub spike: Option<i16>,
    /// The gyroscope and accelerometer are saturated.
    pub saturate: bool,
    /// The magnetometer overflows.
    pub mag_overflow: bool,
    /// The magnetometer die of a combined chip is dead. For a separate chip, use [`Machine::nack`].
    pub mag_dead: bool,
}

/// A chip on the bus.
pub trait Device: Send {
    /// True if it answers to this address at present.
    fn answers(&self, address: u8) -> bool;
    /// A write transfer: a register address and data.
    fn write(&mut self, address: u8, bytes: &[u8]);
    /// A read transfer from the current register on.
    fn read(&mut self, address: u8, out: &mut [u8]);
    /// Time passes, s; conversions that fall due are made from the present motion.
    fn advance(&mut self, dt_s: f64);
    /// The true motion from now on.
    fn set_motion(&mut self, motion: &Motion);
    /// Noise of the conversions from now on.
    fn set_noise(&mut self, noise: Noise);
    /// The supply dips: all registers fall back to their power-on values.
    fn brown_out(&mut self);
    /// Its faults.
    fn quirks(&mut self) -> &mut Quirks;
}

/// Inputs of a conversion besides the registers.
#[derive(Debug)]
struct Analog {
    motion: Motion,
    noise: Noise,
    quirks: Quirks,
    rng: StdRng,
}

impl Analog {
    fn new(seed: u64) -> Self {
        let rng = StdRng::seed_from_u64(seed);
        Self {
            motion: Motion::default(),
            noise: Noise::TYPICAL,
            quirks: Quirks::default(),
            rng,
        }
    }
    /// Truth plus noise in counts, limited to the range of the converter.
    fn counts(&mut self, truth: Vector3<f64>, sigma: f64, unit: f64) -> [i16; 3] {
        let mut axis = |x: f64| {
            let noise: f64 = StandardNormal.sample(&mut self.rng);
            ((x + sigma * noise) / unit)
                .round()
                .clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16
        };
        [axis(truth.x), axis(truth.y), axis(truth.z)]
    }
    /// Gyroscope and accelerometer counts, with the faults applied.
    fn inertial(&mut self, gyro_unit: f64, acc_unit: f64) -> ([i16; 3], [i16; 3]) {
        let gyro = self.counts(self.motion.gyro_rad_s, self.noise.gyro_rad_s, gyro_unit);
        let acc = self.counts(self.motion.acc_m_s2, self.noise.acc_m_s2, acc_unit);
        if self.quirks.saturate {
            let stop = |c: i16| if c < 0 { i16::MIN } else { i16::MAX };
            return (gyro.map(stop), acc.map(stop));
        }
        match self.quirks.spike.take() {
            Some(wild) => ([wild; 3], [wild; 3]),
            None => (gyro, acc),
        }
    }
}

/// Counts conversions that fall due at a fixed rate.
#[derive(Debug, Clone, Copy, Default)]
struct Ticker {
    since_s: f64,
}

impl Ticker {
    /// Lets time pass; true when at least one conversion fell due. Only the last one is visible.
    fn due(&mut self, dt_s: f64, period_s: f64) -> bool {
        self.since_s += dt_s;
        let due = self.since_s >= period_s - 1e-12;
        if due {
            self.since_s = self.since_s.rem_euclid(period_s);
        }
        due
    }
}

/// A transfer that failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FakeBusError {
    /// No chip acknowledged.
    #[error("no acknowledge")]
    Nack,
    /// A line is held down.
    #[error("bus stuck")]
    Stuck,
}

impl FakeBusError {
    /// The error number of a Raspberry Pi's kernel.
    #[must_use]
    pub fn errno(self) -> i32 {
        match self {
            Self::Nack => 121,  // EREMOTEIO
            Self::Stuck => 110, // ETIMEDOUT
        }
    }
}

impl embedded_hal::i2c::Error for FakeBusError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Nack => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            Self::Stuck => ErrorKind::Bus,
        }
    }
}

/// A bus with its chips.
#[derive(Default)]
pub struct Machine {
    devices: Vec<Box<dyn Device>>,
    nacks: Vec<(u8, u32)>,
    short: Option<(u8, usize)>,
    /// Every transfer times out while this is set.
    pub stuck: bool,
    messages: u64,
    bits: u64,
}

impl Machine {
    /// Adds a chip.
    pub fn attach(&mut self, device: impl Device + 'static) {
        self.devices.push(Box::new(device));
    }
    /// The chip at an address, to change its motion or its faults.
    pub fn device(&mut self, address: u8) -> Option<&mut (dyn Device + 'static)> {
        self.devices
            .iter_mut()
            .find(|d| d.answers(address))
            .map(|d| &mut **d)
    }
    /// Changes the faults of the chip at an address. An address without a chip is ignored.
    pub fn spoil(&mut self, address: u8, change: impl FnOnce(&mut Quirks)) {
        if let Some(device) = self.device(address) {
            change(device.quirks());
        }
    }
    /// The true motion of every chip from now on.
    pub fn set_motion(&mut self, motion: &Motion) {
        self.devices.iter_mut().for_each(|d| d.set_motion(motion));
    }
    /// The noise of every chip from now on.
    pub fn set_noise(&mut self, noise: Noise) {
        self.devices.iter_mut().for_each(|d| d.set_noise(noise));
    }
    /// Time passes for every chip, s.
    pub fn advance(&mut self, dt_s: f64) {
        self.devices.iter_mut().for_each(|d| d.advance(dt_s));
    }
    /// The supply of every chip dips.
    pub fn brown_out(&mut self) {
        self.devices.iter_mut().for_each(|d| d.brown_out());
    }
    /// The next `n` messages to an address are not acknowledged; 0 ends it.
    pub fn nack(&mut self, address: u8, n: u32) {
        self.nacks.retain(|(a, _)| *a != address);
        self.nacks.push((address, n));
    }
    /// The next longer read from an address ends after `have` bytes: the line floats high.
    pub fn shorten(&mut self, address: u8, have: usize) {
        self.short = Some((address, have));
    }
    /// Messages so far.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.messages
    }
    /// Time the messages so far would have taken at a clock, s: nine bits a byte, the address
    /// included, and one each for start and stop.
    #[must_use]
    pub fn bus_time_s(&self, clock_hz: f64) -> f64 {
        self.bits as f64 / clock_hz
    }

    fn admit(&mut self, address: u8, bytes: usize) -> Result<&mut Box<dyn Device>, FakeBusError> {
        self.messages += 1;
        self.bits += 9 * (bytes as u64 + 1) + 2;
        if self.stuck {
            return Err(FakeBusError::Stuck);
        }
        if let Some((_, n)) = self.nacks.iter_mut().find(|(a, n)| *a == address && *n > 0) {
            *n -= 1;
            return Err(FakeBusError::Nack);
        }
        self.devices
            .iter_mut()
            .find(|d| d.answers(address))
            .ok_or(FakeBusError::Nack)
    }
    /// A write message.
    ///
    /// # Errors
    /// [`FakeBusError`] if no chip answers or the bus is faulty.
    pub fn write(&mut self, address: u8, bytes: &[u8]) -> Result<(), FakeBusError> {
        self.admit(address, bytes.len())?.write(address, bytes);
        Ok(())
    }
    /// A read message.
    ///
    /// # Errors
    /// [`FakeBusError`] if no chip answers or the bus is faulty.
    pub fn read(&mut self, address: u8, out: &mut [u8]) -> Result<(), FakeBusError> {
        self.admit(address, out.len())?.read(address, out);
        if let Some((_, have)) = self
            .short
            .take_if(|(a, have)| *a == address && *have < out.len())
        {
            out[have..].fill(0xFF);
        }
        Ok(())
    }
}

/// A handle on a shared [`Machine`]: every driver takes a clone.
#[derive(Clone, Default)]
pub struct FakeBus(Arc<Mutex<Machine>>);

impl FakeBus {
    /// A bus without chips.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }
    /// The machine behind the handle.
    pub fn machine(&self) -> MutexGuard<'_, Machine> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
    /// A clock for drivers: waiting lets the chips' time pass.
    #[must_use]
    pub fn delay(&self) -> FakeDelay {
        FakeDelay(self.clone())
    }
}

impl ErrorType for FakeBus {
    type Error = FakeBusError;
}

impl I2c for FakeBus {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), FakeBusError> {
        let mut machine = self.machine();
        for operation in operations {
            match operation {
                Operation::Write(bytes) => machine.write(address, bytes)?,
                Operation::Read(out) => machine.read(address, out)?,
            }
        }
        Ok(())
    }
}

/// Waiting on a [`FakeBus`] advances its chips instead of the wall clock.
#[derive(Clone)]
pub struct FakeDelay(FakeBus);

impl DelayNs for FakeDelay {
    fn delay_ns(&mut self, ns: u32) {
        self.0.machine().advance(f64::from(ns) * 1e-9);
    }
}
