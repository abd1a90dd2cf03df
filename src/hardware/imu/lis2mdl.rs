//! LIS2MDL: a separate magnetometer at address 0x1E.
//!
//! Source: ST DS12144 (registers, chapter 8) and AN5069. 1.5 mG = 0.15 µT per count, ±49.152 G, block
//! data update. The address counter wraps from OUTZ_H (0x6D) to OUTX_L (0x68), so a burst cannot reach
//! the temperature at 0x6E. Status and data (0x67 … 0x6D) are one burst of seven bytes.

use super::chip::Device;
use super::{Chip, ImuError, Part};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

/// Register addresses (DS12144, table of registers).
pub mod reg {
    /// Identity.
    pub const WHO_AM_I: u8 = 0x4F;
    /// Temperature compensation, reset, rate, mode.
    pub const CFG_REG_A: u8 = 0x60;
    /// Offset cancellation, low-pass.
    pub const CFG_REG_B: u8 = 0x61;
    /// Block data update.
    pub const CFG_REG_C: u8 = 0x62;
    /// New data; first byte of the burst.
    pub const STATUS: u8 = 0x67;
}

/// Content of WHO_AM_I.
pub const WHO_AM_I: u8 = 0x40;
/// The only address.
pub const ADDRESS: u8 = 0x1E;
/// µT per count (1.5 mG).
pub const UT_PER_LSB: f64 = 0.15;
const SOFT_RST: u8 = 0x20; // CFG_REG_A
const CFG_B: u8 = 0x02; // OFF_CANC: set/reset pulses cancel the bridge offset
const CFG_C: u8 = 0x10; // BDU
const RESET_LIMIT_MS: u32 = 20;
const CHIP: Chip = Chip {
    part: Part::Lis2mdl,
    address: ADDRESS,
};

/// The chip's part of the two-chip driver. The caller owns the bus.
#[derive(Debug)]
pub struct Lis2mdl {
    cfg_a: u8,
    last: Option<[i16; 3]>,
}

impl Lis2mdl {
    /// A driver for 10, 20, 50 or 100 Hz, temperature-compensated and continuous.
    pub fn new(rate_hz: u16) -> Self {
        // every valid rate is in the list
        let rate = [10, 20, 50, 100].iter().position(|r| *r == rate_hz);
        Self {
            cfg_a: 0x80 | (rate.unwrap_or(0) as u8) << 2,
            last: None,
        }
    }

    /// Identifies, resets and configures the chip.
    ///
    /// # Errors
    /// [`ImuError`] when it is absent, is another part, or does not start.
    pub fn init<I: I2c>(&mut self, bus: &mut I, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.last = None;
        let mut device = Device { bus, chip: CHIP };
        CHIP.identify(device.get(reg::WHO_AM_I)?, WHO_AM_I)?;
        device.set(reg::CFG_REG_A, SOFT_RST)?;
        device.wait_for_reset(delay, reg::CFG_REG_A, SOFT_RST, RESET_LIMIT_MS)?;
        device.set(reg::CFG_REG_C, CFG_C)?;
        device.set(reg::CFG_REG_B, CFG_B)?;
        device.set(reg::CFG_REG_A, self.cfg_a)?;
        delay.delay_ms(10); // turn-on time
        Ok(())
    }

    /// A new value in the chip's axes, if there is one.
    ///
    /// # Errors
    /// [`ImuError`] when the transfer fails.
    pub fn read<I: I2c>(&mut self, bus: &mut I) -> Result<Option<[i16; 3]>, ImuError> {
        let mut b = [0_u8; 7];
        Device { bus, chip: CHIP }.read(reg::STATUS, &mut b)?;
        let le = |i: usize| i16::from_le_bytes([b[i], b[i + 1]]);
        let value = [le(1), le(3), le(5)];
        if value == [-1; 3] {
            return Err(CHIP.short(&b)); // −1 on all three axes means an undriven line
        }
        let new = b[0] & 0x08 != 0 || self.last.is_some_and(|last| last != value);
        if new {
            self.last = Some(value);
        }
        Ok(new.then_some(value))
    }

    /// Compares the configuration with the values written.
    ///
    /// # Errors
    /// [`ImuError::ResetToDefaults`] after a restart.
    pub fn check<I: I2c>(&self, bus: &mut I) -> Result<(), ImuError> {
        let want = [(self.cfg_a, 0xFF), (CFG_B, 0x1F), (CFG_C, 0x38)];
        Device { bus, chip: CHIP }.check(reg::CFG_REG_A, &want)
    }
}
