//! The supported chips.

use crate::named;
use std::fmt;

named! {
    /// A part.
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

/// A part at a 7-bit address of a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chip {
    /// The part.
    pub part: Part,
    /// 7-bit address.
    pub address: u8,
}

impl fmt::Display for Chip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at {:#04x}", self.part, self.address)
    }
}
