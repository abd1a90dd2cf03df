//! Register addresses of an LSM6DSO and an LSM6DSV16X; the fields of the settings differ.

/// Identity.
pub const WHO_AM_I: u8 = 0x0F;
/// Accelerometer rate; on the LSM6DSO also range and second filter.
pub const CTRL1: u8 = 0x10;
/// Gyroscope rate; on the LSM6DSO also range.
pub const CTRL2: u8 = 0x11;
/// Block data update, address increment, reset.
pub const CTRL3: u8 = 0x12;
/// LSM6DSO: gyroscope filter on.
pub const CTRL4: u8 = 0x13;
/// Gyroscope filter width; on the LSM6DSV16X also range.
pub const CTRL6: u8 = 0x15;
/// LSM6DSV16X: gyroscope filter on.
pub const CTRL7: u8 = 0x16;
/// Accelerometer filter width; on the LSM6DSV16X also range.
pub const CTRL8: u8 = 0x17;
/// LSM6DSO: I3C off. LSM6DSV16X: accelerometer filter on.
pub const CTRL9: u8 = 0x18;
/// New data; first byte of the burst.
pub const STATUS_REG: u8 = 0x1E;
