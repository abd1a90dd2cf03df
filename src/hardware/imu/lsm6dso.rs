//! LSM6DSO or LSM6DSV16X with a separate LIS2MDL: six and three axes at two addresses.
//!
//! Source: ST DS12140 rev. 2 (registers: chapter 9; outputs p. 66-67; rates p. 10); for the LSM6DSV16X the register definitions of
//! ST's own driver (STMicroelectronics/lsm6dsv16x-rs, `src/register/main.rs`). The two differ in the registers of their settings
//! ([`Variant`]), not in those of the data. Status,
//! temperature and all six axes (0x1E … 0x2D) are one burst of sixteen bytes, little-endian. Block
//! data update keeps the bytes of a conversion together. The magnetometer is read only when it can have
//! a new measurement.

mod config;
pub mod reg;

pub use config::{LsmConfig, RATES_HZ, Settings, Variant, scale};

use super::chip::Device;
use super::lis2mdl::Lis2mdl;
use super::{Chip, Identity, Imu, ImuError, RawImu, Scale};
use crate::primitives::Invalid;
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

const BURST: usize = 16;
const RESET_LIMIT_MS: u32 = 20;
/// Magnetometer counts from here on count as overflow: within 0.2 % of the full scale of ±32,768 counts.
const MAG_OVERFLOW: u16 = 32_700;

/// Driver for both chips on one bus.
#[derive(Debug)]
pub struct Lsm6dsoLis2mdl<I> {
    device: Device<I>,
    who_am_i: u8,
    mag: Lis2mdl,
    settings: Settings,
    ready: bool,
    reads: u16,
    since_mag: u16,
}

impl<I: I2c> Lsm6dsoLis2mdl<I> {
    /// A driver of one of the parts that has not accessed its chips yet.
    ///
    /// # Errors
    /// [`Invalid`] for a setting that the parts do not support.
    pub fn new(bus: I, config: &LsmConfig, variant: Variant) -> Result<Self, Invalid> {
        let (part, who_am_i, _) = variant.part();
        let address = config.address;
        let chip = Chip { part, address };
        Ok(Self {
            device: Device { bus, chip },
            who_am_i,
            mag: Lis2mdl::new(config.mag_rate_hz),
            settings: config.settings(variant)?,
            ready: false,
            reads: 0,
            since_mag: 0,
        })
    }

    fn configure(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        let device = &mut self.device;
        device.set(reg::CTRL3, 0x05)?; // IF_INC, SW_RESET
        device.wait_for_reset(delay, reg::CTRL3, 0x01, RESET_LIMIT_MS)?;
        for (register, value) in self.settings.writes {
            device.set(register, value)?;
        }
        delay.delay_ms(80); // gyroscope turn-on
        Ok(())
    }

    fn canary(&mut self, raw: &mut RawImu) -> Result<(), ImuError> {
        self.reads = self.reads.wrapping_add(1);
        if self.settings.canary_every == 0 || self.reads < self.settings.canary_every {
            return Ok(());
        }
        self.reads = 0;
        self.device.check(reg::CTRL1, &self.settings.canary)?;
        let mag = self.mag.check(&mut self.device.bus);
        raw.mag_fault = raw.mag_fault.or(mag.err());
        Ok(())
    }

    fn burst(&mut self) -> Result<RawImu, ImuError> {
        let mut b = [0_u8; BURST];
        self.device.read(reg::STATUS_REG, &mut b)?;
        let le = |i: usize| i16::from_le_bytes([b[i], b[i + 1]]);
        let acc = [le(10), le(12), le(14)];
        // Status bits 7:3 are never all 1, and −1 on all axes would be free fall: the line is not driven.
        if b[0] & 0xF8 == 0xF8 || acc == [-1; 3] {
            return Err(self.device.chip.short(&b));
        }
        Ok(RawImu {
            gyro: [le(4), le(6), le(8)],
            acc,
            temp: le(2),
            mag: None,
            fresh: b[0] & 0x03 == 0x03,
            mag_overflow: false,
            mag_fault: None,
        })
    }

    /// Reads the magnetometer when it can have a new measurement. If that fails, the other axes remain valid.
    fn read_mag(&mut self, raw: &mut RawImu) {
        self.since_mag += 1;
        if self.since_mag >= self.settings.mag_every {
            self.since_mag = 0;
            match self.mag.read(&mut self.device.bus) {
                Ok(value) => raw.mag = value,
                Err(error) => raw.mag_fault = Some(error),
            }
            let overflows = |m: [i16; 3]| m.iter().any(|c| c.unsigned_abs() >= MAG_OVERFLOW);
            raw.mag_overflow = raw.mag.is_some_and(overflows);
        }
    }
}

impl<I: I2c> Imu for Lsm6dsoLis2mdl<I> {
    fn init(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError> {
        self.ready = false;
        (self.reads, self.since_mag) = (0, 0);
        let have = self.device.get(reg::WHO_AM_I)?;
        self.device.chip.identify(have, self.who_am_i)?;
        self.configure(delay)?;
        self.mag.init(&mut self.device.bus, delay)?;
        self.ready = true;
        Ok(Identity {
            inertial: self.device.chip,
            rate_hz: self.settings.rate_hz,
        })
    }

    fn read(&mut self) -> Result<RawImu, ImuError> {
        if !self.ready {
            return Err(ImuError::NotReady(self.device.chip.part));
        }
        let mut raw = self.burst()?;
        self.read_mag(&mut raw);
        if let Err(error) = self.canary(&mut raw) {
            self.ready &= !matches!(error, ImuError::ResetToDefaults { .. });
            return Err(error);
        }
        Ok(raw)
    }

    fn restart_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.mag.init(&mut self.device.bus, delay)
    }

    fn scale(&self) -> Scale {
        self.settings.scale
    }
}
