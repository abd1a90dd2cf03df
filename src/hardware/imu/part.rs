//! The supported chips, and what a driver found on the bus.

use crate::named;

named! {
    /// A chip.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Part {
        /// TDK InvenSense ICM-20948: gyroscope and accelerometer.
        Icm20948 = "ICM-20948",
        /// Asahi Kasei AK09916: the magnetometer inside the ICM-20948.
        Ak09916 = "AK09916",
        /// ST LSM6DSO: gyroscope and accelerometer.
        Lsm6dso = "LSM6DSO",
        /// ST LSM6DSV16X: gyroscope and accelerometer.
        Lsm6dsv16x = "LSM6DSV16X",
        /// ST LIS2MDL: magnetometer.
        Lis2mdl = "LIS2MDL",
    }
}

/// A chip that answered with the expected identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChipId {
    /// The part.
    pub part: Part,
    /// 7-bit address.
    pub address: u8,
    /// Content of its identity register.
    pub id: u8,
}

/// The chips that `init` found, and their rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identity {
    /// Gyroscope and accelerometer.
    pub inertial: ChipId,
    /// Magnetometer.
    pub magnetic: ChipId,
    /// Conversions per second of gyroscope and accelerometer.
    pub rate_hz: f64,
    /// Conversions per second of the magnetometer.
    pub mag_rate_hz: f64,
}
