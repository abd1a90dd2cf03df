//! Inertial sensors on I²C behind one trait.
//!
//! A driver owns a bus handle and handles the registers of its part. [`Imu::read`] returns counts, and
//! [`Scale::sample`] converts them to SI units and adds the time. A second sensor (on the base) is a
//! second instance with another address and a second handle on the same bus.
//!
//! | part | transfers per reading | bus time at 400 kHz |
//! |---|---|---|
//! | `icm20948` | one of 23 bytes, nine axes | 0.59 ms |
//! | `lsm6dso_lis2mdl`, `lsm6dsv16x_lis2mdl` | one of 16 bytes; a second of 7 when the magnetometer is due | 0.43 + 0.23 ms |
//!
//! A driver is polled a quarter faster than its chip converts ([`POLL_SHARE`]), and readings without a new conversion are
//! dropped, so that no conversion is lost.
//!
//! Every `canary_every` readings the driver reads back a few settings. A chip that has restarted after a
//! supply dip still answers, but with its power-on ranges, which only this check detects
//! ([`ImuError::ResetToDefaults`]).
//!
//! A new part needs a driver file, its [`Part`], and in this file its `mod` line and its variant of [`ChipConfig`].

pub mod bus_clear;
mod chip;
mod driver;
mod error;
#[cfg(test)]
#[path = "../../../tests/fake_imu/mod.rs"]
pub(crate) mod fake;
pub mod icm20948;
pub mod linux;
pub mod lis2mdl;
pub mod lsm6dso;
mod part;
mod raw;
mod recovery;

pub use driver::{Identity, Imu};
pub use error::ImuError;
pub use part::{Chip, Part};
pub use raw::{Axes, Axis, RawImu, STANDARD_GRAVITY_M_S2, Scale};
pub use recovery::{ImuRecovery, POLL_SHARE};

use crate::primitives::{Invalid, Parameters, Setting, Shape};
use embedded_hal::i2c::I2c;
use lsm6dso::{Lsm6dsoLis2mdl, Variant};
use serde::{Deserialize, Serialize};

/// The `chip` table of a sensor: `part = "icm20948"`, `"lsm6dso_lis2mdl"` or `"lsm6dsv16x_lis2mdl"`, and the settings of that part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "part", rename_all = "snake_case")]
pub enum ChipConfig {
    /// One chip with nine axes; the default.
    Icm20948(icm20948::IcmConfig),
    /// Two chips on one bus.
    #[serde(rename = "lsm6dso_lis2mdl")]
    Lsm6dsoLis2mdl(lsm6dso::LsmConfig),
    /// The same with the successor of the first.
    #[serde(rename = "lsm6dsv16x_lis2mdl")]
    Lsm6dsv16xLis2mdl(lsm6dso::LsmConfig),
}

impl Setting for ChipConfig {
    const SHAPE: Shape = Shape::Tagged(
        "part",
        &[
            ("icm20948", icm20948::IcmConfig::TABLE),
            ("lsm6dso_lis2mdl", lsm6dso::LsmConfig::TABLE),
            ("lsm6dsv16x_lis2mdl", lsm6dso::LsmConfig::TABLE),
        ],
    );
}

impl Default for ChipConfig {
    fn default() -> Self {
        Self::Icm20948(icm20948::IcmConfig::default())
    }
}

impl ChipConfig {
    /// Bus address of the inertial chip.
    pub fn address(&self) -> u8 {
        match self {
            Self::Icm20948(c) => c.address,
            Self::Lsm6dsoLis2mdl(c) | Self::Lsm6dsv16xLis2mdl(c) => c.address,
        }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// The first setting that the part does not support.
    pub fn check(&self) -> Result<(), Invalid> {
        match self {
            Self::Icm20948(c) => c.settings().map(|_| ()),
            Self::Lsm6dsoLis2mdl(c) => c.settings(Variant::Dso).map(|_| ()),
            Self::Lsm6dsv16xLis2mdl(c) => c.settings(Variant::Dsv16x).map(|_| ()),
        }
    }
}

/// The driver for a configuration, not yet initialised.
///
/// # Errors
/// [`Invalid`] for a setting that the part does not support.
pub fn open<I: I2c + Send + 'static>(
    config: &ChipConfig,
    bus: I,
) -> Result<Box<dyn Imu + Send>, Invalid> {
    Ok(match config {
        ChipConfig::Icm20948(c) => Box::new(icm20948::Icm20948::new(bus, c)?),
        ChipConfig::Lsm6dsoLis2mdl(c) => Box::new(Lsm6dsoLis2mdl::new(bus, c, Variant::Dso)?),
        ChipConfig::Lsm6dsv16xLis2mdl(c) => Box::new(Lsm6dsoLis2mdl::new(bus, c, Variant::Dsv16x)?),
    })
}
