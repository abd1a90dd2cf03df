//! Inertial sensors on I²C, behind one trait.
//!
//! A driver owns its bus handle, knows its part's registers and nothing of time: [`Imu::read`] gives
//! counts, [`Scale::sample`] stamps and scales them. A second sensor (on the base) is a second
//! instance with another address and a second handle on the same bus.
//!
//! | part | transfers a reading | bus time at 400 kHz |
//! |---|---|---|
//! | `icm20948` | one of 23 bytes, nine axes | 0.59 ms |
//! | `lsm6dso_lis2mdl` | one of 16 bytes; a second of 7 when the magnetometer is due | 0.43 + 0.23 ms |
//!
//! Every `canary_every` readings a few settings are read back: a chip that restarted on a supply dip
//! answers politely at its power-on ranges, and only this tells ([`ImuError::ResetToDefaults`]).
//! [`fake`] holds register-level twins of the parts, for tests and for the emulated bus.

mod error;
#[cfg(test)]
#[path = "../../../tests/fake_imu/mod.rs"]
pub(crate) mod fake;
pub mod icm20948;
#[cfg(feature = "hw")]
pub mod linux;
pub mod lis2mdl;
pub mod lsm6dso;
mod port;
mod raw;
mod recovery;

pub use error::{ConfigError, ImuError};
pub use raw::{Axes, Axis, RawImu, STANDARD_GRAVITY_M_S2, Scale};
pub use recovery::{ImuRecovery, RecoveryConfig};

use crate::estimation::fusion::health::ImuReading;
use crate::estimation::imu_calibration::Correction;
use crate::primitives::units::Seconds;
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use serde::{Deserialize, Serialize};

/// A chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// TDK InvenSense ICM-20948: gyroscope and accelerometer.
    Icm20948,
    /// Asahi Kasei AK09916: the magnetometer inside the ICM-20948.
    Ak09916,
    /// ST LSM6DSO: gyroscope and accelerometer.
    Lsm6dso,
    /// ST LIS2MDL: magnetometer.
    Lis2mdl,
}

impl std::fmt::Display for Part {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Icm20948 => "ICM-20948",
            Self::Ak09916 => "AK09916",
            Self::Lsm6dso => "LSM6DSO",
            Self::Lis2mdl => "LIS2MDL",
        })
    }
}

/// A chip that answered with its right name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChipId {
    /// Which part.
    pub part: Part,
    /// 7-bit address.
    pub address: u8,
    /// Content of its identity register.
    pub id: u8,
}

/// What `init` found and set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identity {
    /// Gyroscope and accelerometer.
    pub inertial: ChipId,
    /// Magnetometer.
    pub magnetic: ChipId,
    /// Conversions a second of gyroscope and accelerometer.
    pub rate_hz: f64,
    /// Conversions a second of the magnetometer.
    pub mag_rate_hz: f64,
}

/// A nine-axis sensor.
pub trait Imu {
    /// Identifies the chips, resets and configures them. May be called again at any time; takes up
    /// to half a second.
    ///
    /// # Errors
    /// [`ImuError`] when a chip is absent, another one, or does not come up.
    fn init(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError>;

    /// One reading, without waiting for a new conversion.
    ///
    /// # Errors
    /// [`ImuError`] when the transfer failed or a restart was found. After
    /// [`ImuError::ResetToDefaults`] only `init` helps.
    fn read(&mut self) -> Result<RawImu, ImuError>;

    /// How to read the counts under the present configuration.
    fn scale(&self) -> Scale;
}

/// The `[imu]` table: `part = "icm20948"` or `part = "lsm6dso_lis2mdl"`, and that part's settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "part", rename_all = "snake_case")]
pub enum ImuConfig {
    /// One chip with everything inside; the default.
    Icm20948(icm20948::IcmConfig),
    /// Two chips on one bus.
    #[serde(rename = "lsm6dso_lis2mdl")]
    Lsm6dsoLis2mdl(lsm6dso::LsmConfig),
}

impl Default for ImuConfig {
    fn default() -> Self {
        Self::Icm20948(icm20948::IcmConfig::default())
    }
}

/// The driver for a configuration, not yet initialised.
///
/// # Errors
/// [`ConfigError`] for a setting that the part does not have.
pub fn open<I: I2c + Send + 'static>(config: &ImuConfig, bus: I) -> Result<Box<dyn Imu + Send>, ConfigError> {
    Ok(match config {
        ImuConfig::Icm20948(c) => Box::new(icm20948::Icm20948::new(bus, c)?),
        ImuConfig::Lsm6dsoLis2mdl(c) => Box::new(lsm6dso::Lsm6dsoLis2mdl::new(bus, c)?),
    })
}

/// A reading as the health judge wants it: scaled, corrected and stamped, or the fault.
#[must_use]
pub fn outcome(result: &Result<RawImu, ImuError>, scale: &Scale, correction: &Correction, t: Seconds) -> ImuReading {
    match result {
        Ok(raw) => ImuReading::Sample(correction.apply(&scale.sample(raw, t)), raw.quality()),
        Err(error) => ImuReading::Failed(error.fault()),
    }
}
