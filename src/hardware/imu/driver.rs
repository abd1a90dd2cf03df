//! The trait that every sensor driver implements.

use super::{Chip, ImuError, RawImu, Scale};
use embedded_hal::delay::DelayNs;

/// What `init` found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identity {
    /// Gyroscope and accelerometer.
    pub inertial: Chip,
    /// Conversions per second of gyroscope and accelerometer.
    pub rate_hz: f64,
}

/// A nine-axis sensor.
pub trait Imu {
    /// Identifies, resets and configures the chips. Takes up to half a second and may be repeated at any
    /// time.
    ///
    /// # Errors
    /// [`ImuError`] when a chip is absent, is another part, or does not start.
    fn init(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError>;

    /// Reads once, without waiting for a new conversion.
    ///
    /// # Errors
    /// [`ImuError`] when the transfer fails or the chip has restarted. After
    /// [`ImuError::ResetToDefaults`], `init` is required.
    fn read(&mut self) -> Result<RawImu, ImuError>;

    /// Sets up the magnetometer alone, while the other axes go on. Takes some 10 ms, or 50 ms if it does not answer.
    ///
    /// # Errors
    /// [`ImuError`] when it is absent, is another part, or does not start.
    fn restart_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError>;

    /// The scale of the counts in the present configuration.
    fn scale(&self) -> Scale;
}
