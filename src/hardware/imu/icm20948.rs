//! ICM-20948: nine axes in one chip, read with one burst.
//!
//! Source: TDK InvenSense DS-000189 rev. 1.3. The inertial die and an AK09916 magnetometer share the
//! package; the magnetometer is on the chip's own auxiliary I²C bus. The driver configures the internal
//! bus master to fetch the magnetometer's nine status and data bytes (ST1 0x10 … ST2 0x18, p. 77) after
//! every gyroscope conversion into EXT_SLV_SENS_DATA, which follows the inertial data in the register map:
//!
//! ```text
//! 0x2D acc x y z | 0x33 gyr x y z | 0x39 temp | 0x3B ST1 | 0x3C mag x y z | 0x42 TMPS | 0x43 ST2
//!      6 bytes BE |     6 bytes BE |  2 bytes |  1       |   6 bytes LE   |  1 (zero) |  1
//! ```
//!
//! One 23-byte burst is therefore a complete, consistent sample (burst reads: p. 30). Reading up to ST2
//! also releases the magnetometer's data latch (p. 79). Special properties:
//!
//! * LP_CONFIG is 0x40 after power-on, which duty-cycles the internal master (p. 37). The driver clears it.
//! * The reset of the inertial die does not reset the AK09916, which has its own (CNTL3.SRST).
//! * DELAY_ES_SHADOW keeps half-fetched magnetometer bytes out of the burst.
//! * The magnetometer's y and z axes are opposite to those of the other sensors
//!   ([`super::Axes::AK09916`], orientation of axes).
//! * The magnetometer's offset may be ±2000 counts = ±300 µT (p. 13), so it requires calibration.

mod config;
pub mod reg;

pub use config::{BASE_RATE_HZ, IcmConfig, Settings, scale};

use super::chip::Device;
use super::{Chip, Identity, Imu, ImuError, Part, RawImu, Scale};
use crate::primitives::Invalid;
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

/// Content of WHO_AM_I (DS-000189, 8.1).
pub const WHO_AM_I: u8 = 0xEA;
/// Content of the AK09916's WIA2 (p. 78).
pub const AK_WHO_AM_I: u8 = 0x09;
/// Address of the AK09916 on the internal bus (and outside, in bypass).
pub const AK_ADDRESS: u8 = 0x0C;
const AK: Chip = Chip {
    part: Part::Ak09916,
    address: AK_ADDRESS,
};
const BURST: usize = 23;
const SLV4_LIMIT_MS: u32 = 20;
const RESET_LIMIT_MS: u32 = 100;
const MAG_TRIES: u32 = 5;

/// The driver. `I` is its own bus handle.
#[derive(Debug)]
pub struct Icm20948<I> {
    device: Device<I>,
    settings: Settings,
    ready: bool,
    bank: Option<u8>,
    reads: u16,
    /// Which of the three checks is next.
    check: u8,
    /// The mode of the magnetometer has been asked for.
    mode_asked: bool,
    last: Option<RawImu>,
    last_mag: Option<[i16; 3]>,
}

impl<I: I2c> Icm20948<I> {
    /// A driver that has not accessed its chip yet.
    ///
    /// # Errors
    /// [`Invalid`] for a setting that the part does not support.
    pub fn new(bus: I, config: &IcmConfig) -> Result<Self, Invalid> {
        let chip = Chip {
            part: Part::Icm20948,
            address: config.address,
        };
        Ok(Self {
            device: Device { bus, chip },
            settings: config.settings()?,
            ready: false,
            bank: None,
            reads: 0,
            check: 0,
            mode_asked: false,
            last: None,
            last_mag: None,
        })
    }

    /// Selects a bank. After a failure the selected bank is unknown.
    fn bank(&mut self, bank: u8) -> Result<(), ImuError> {
        self.bank = None;
        self.device.set(reg::BANK_SEL, bank << 4)?;
        self.bank = Some(bank);
        Ok(())
    }

    fn reset(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.device.set(reg::PWR_MGMT_1, 0x80)?;
        delay.delay_ms(10);
        self.device
            .wait_for_reset(delay, reg::PWR_MGMT_1, 0x80, RESET_LIMIT_MS)?;
        self.device.set(reg::PWR_MGMT_1, 0x01)?; // awake, best clock
        delay.delay_ms(35); // gyroscope start-up (DS-000189, table 1)
        self.device.set(reg::PWR_MGMT_2, 0x00)?;
        self.device.set(reg::LP_CONFIG, 0x00)?;
        self.device.set(reg::INT_PIN_CFG, 0x00)
    }

    fn ranges(&mut self) -> Result<(), ImuError> {
        let s = self.settings;
        self.bank(2)?;
        self.device.set(reg::ODR_ALIGN_EN, 0x01)?;
        self.device.set(reg::GYRO_SMPLRT_DIV, s.divider)?;
        self.device.set(reg::GYRO_CONFIG_1, s.gyro_config)?;
        self.device.set(reg::ACCEL_SMPLRT_DIV_1, 0x00)?;
        self.device.set(reg::ACCEL_SMPLRT_DIV_2, s.divider)?;
        self.device.set(reg::ACCEL_CONFIG, s.acc_config)?;
        self.bank(0)
    }

    fn start_master(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.device.set(reg::USER_CTRL, 0x02)?; // internal master reset, clears itself
        delay.delay_ms(2);
        self.device.set(reg::USER_CTRL, 0x20)?; // internal master on
        self.bank(3)?;
        self.device.set(reg::I2C_MST_CTRL, 0x17)?; // stop between reads, 345.6 kHz
        self.device.set(reg::I2C_MST_DELAY_CTRL, 0x80)?; // DELAY_ES_SHADOW
        self.bank(0)
    }

    /// Begins a transfer of [`Self::aux`].
    fn ask(&mut self, register: u8, write: Option<u8>) -> Result<(), ImuError> {
        self.bank(3)?;
        let direction = if write.is_some() { 0 } else { 0x80 };
        self.device
            .set(reg::I2C_SLV4_ADDR, AK_ADDRESS | direction)?;
        self.device.set(reg::I2C_SLV4_REG, register)?;
        self.device.set(reg::I2C_SLV4_DO, write.unwrap_or(0))?;
        self.device.set(reg::I2C_SLV4_CTRL, 0x80)?;
        self.bank(0)
    }

    /// Transfers one byte to or from the magnetometer through the one-shot slave.
    fn aux(
        &mut self,
        delay: &mut dyn DelayNs,
        register: u8,
        write: Option<u8>,
    ) -> Result<u8, ImuError> {
        self.device.get(reg::I2C_MST_STATUS)?; // reading clears it
        self.ask(register, write)?;
        for _ in 0..SLV4_LIMIT_MS {
            delay.delay_ms(1);
            let status = self.device.get(reg::I2C_MST_STATUS)?;
            if status & 0x10 != 0 {
                return Err(ImuError::Nack(AK));
            }
            if status & 0x40 != 0 {
                self.bank(3)?;
                let value = self.device.get(reg::I2C_SLV4_DI)?;
                self.bank(0)?;
                return Ok(value);
            }
        }
        Err(ImuError::Timeout {
            part: Part::Ak09916,
            what: "a transfer",
            limit_ms: SLV4_LIMIT_MS,
        })
    }

    /// Resets and identifies the magnetometer. It may miss the first transfers after power-on, so the
    /// internal master is restarted between the attempts.
    fn find_mag(&mut self, delay: &mut dyn DelayNs, tries: u32) -> Result<(), ImuError> {
        let mut last = Ok(());
        self.mode_asked = false;
        for _ in 0..tries {
            self.start_master(delay)?;
            last = self.identify_mag(delay);
            if last.is_ok() {
                break;
            }
            delay.delay_ms(5);
        }
        last
    }

    fn identify_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.aux(delay, reg::AK_CNTL3, Some(0x01))?;
        delay.delay_ms(2);
        AK.identify(self.aux(delay, reg::AK_WIA2, None)?, AK_WHO_AM_I)
    }

    fn start_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        let want = self.settings.mag_mode;
        self.aux(delay, reg::AK_CNTL2, Some(want))?;
        let have = self.aux(delay, reg::AK_CNTL2, None)?;
        if let Some(lost) = mode_lost(have, want) {
            return Err(lost);
        }
        self.bank(3)?;
        self.device.set(reg::I2C_SLV0_ADDR, 0x80 | AK_ADDRESS)?;
        self.device.set(reg::I2C_SLV0_REG, reg::AK_ST1)?;
        self.device.set(reg::I2C_SLV0_CTRL, 0x80 | 9)?;
        self.bank(0)
    }

    /// Whether the magnetometer has lost its mode, by the answer to the check before: the answer to this one is not waited for.
    fn check_mode(&mut self) -> Result<Option<ImuError>, ImuError> {
        let status = self.device.get(reg::I2C_MST_STATUS)?;
        let mut lost = None;
        if self.mode_asked && status & 0x50 == 0x40 {
            self.bank(3)?;
            let have = self.device.get(reg::I2C_SLV4_DI)?;
            lost = mode_lost(have, self.settings.mag_mode);
        }
        self.mode_asked = true;
        self.ask(reg::AK_CNTL2, None)?;
        Ok(lost)
    }

    /// Checks power settings, ranges and the mode of the magnetometer in turn, one of them every `canary_every` readings.
    fn canary(&mut self, raw: &mut RawImu) -> Result<(), ImuError> {
        let suspicious = raw.acc == [0; 3] && raw.gyro == [0; 3]; // the values of a sleeping chip
        self.reads = self.reads.wrapping_add(1);
        let due = self.settings.canary_every != 0 && self.reads >= self.settings.canary_every;
        if due {
            self.reads = 0;
            self.check = (self.check + 1) % 3;
        }
        if suspicious || (due && self.check == 1) {
            // USER_CTRL, 0x04 (reserved), LP_CONFIG, PWR_MGMT_1, PWR_MGMT_2
            let want = [
                (0x20, 0xFF),
                (0, 0),
                (0x00, 0x70),
                (0x01, 0xEF),
                (0x00, 0x3F),
            ];
            self.device.check(reg::USER_CTRL, &want)
        } else if due && self.check == 0 {
            raw.mag_fault = self.check_mode()?;
            Ok(())
        } else if due {
            let s = self.settings;
            self.bank(2)?;
            let gyro = [(s.divider, 0xFF), (s.gyro_config, 0x3F)];
            self.device.check(reg::GYRO_SMPLRT_DIV, &gyro)?;
            self.device
                .check(reg::ACCEL_CONFIG, &[(s.acc_config, 0x3F)])?;
            self.bank(0)
        } else {
            Ok(())
        }
    }

    fn burst(&mut self) -> Result<RawImu, ImuError> {
        if self.bank != Some(0) {
            self.bank(0)?; // a transfer failed while another bank was selected
        }
        let mut b = [0_u8; BURST];
        self.device.read(reg::ACCEL_XOUT_H, &mut b)?;
        // TMPS and ST2 have bits that are always 0; all ones means that the chip does not drive the line.
        if b[BURST - 2..] == [0xFF, 0xFF] {
            return Err(self.device.chip.short(&b));
        }
        Ok(decode(&b, &mut self.last_mag))
    }
}

/// A magnetometer in another mode than it was given has restarted.
fn mode_lost(have: u8, want: u8) -> Option<ImuError> {
    (have != want).then(|| AK.part.reset_to_defaults(reg::AK_CNTL2, have, want))
}

/// Decodes the burst. A magnetometer value is new if its data-ready bit is set or if it has changed (after
/// the reset: from zero). The change matters because the internal master may poll, and so clear
/// data-ready, between two bursts.
fn decode(b: &[u8; BURST], last_mag: &mut Option<[i16; 3]>) -> RawImu {
    let be = |i: usize| i16::from_be_bytes([b[i], b[i + 1]]);
    let le = |i: usize| i16::from_le_bytes([b[i], b[i + 1]]);
    let (st1, st2) = (b[14], b[22]);
    let mag = [le(15), le(17), le(19)];
    let new = st1 & 0x01 != 0 || last_mag.unwrap_or([0; 3]) != mag;
    if new {
        *last_mag = Some(mag);
    }
    RawImu {
        acc: [be(0), be(2), be(4)],
        gyro: [be(6), be(8), be(10)],
        temp: be(12),
        mag: new.then_some(mag),
        fresh: true,
        mag_overflow: new && st2 & 0x08 != 0,
        mag_fault: None,
    }
}

impl<I: I2c> Imu for Icm20948<I> {
    fn init(&mut self, delay: &mut dyn DelayNs) -> Result<Identity, ImuError> {
        self.ready = false;
        (self.last, self.last_mag, self.reads) = (None, None, 0);
        self.bank(0)?;
        let have = self.device.get(reg::WHO_AM_I)?;
        self.device.chip.identify(have, WHO_AM_I)?;
        self.reset(delay)?;
        self.ranges()?;
        self.find_mag(delay, MAG_TRIES)?;
        self.start_mag(delay)?;
        delay.delay_ms(10); // first magnetometer measurement
        self.ready = true;
        Ok(Identity {
            inertial: self.device.chip,
            rate_hz: BASE_RATE_HZ / (1.0 + f64::from(self.settings.divider)),
        })
    }

    fn read(&mut self) -> Result<RawImu, ImuError> {
        if !self.ready {
            return Err(ImuError::NotReady(self.device.chip.part));
        }
        let mut raw = self.burst()?;
        if let Err(error) = self.canary(&mut raw) {
            self.ready &= !matches!(error, ImuError::ResetToDefaults { .. });
            return Err(error);
        }
        let inertial = |raw: &RawImu| (raw.gyro, raw.acc);
        raw.fresh = self.last.as_ref().map(inertial) != Some(inertial(&raw));
        self.last = Some(raw);
        Ok(raw)
    }

    fn restart_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.find_mag(delay, 1)?;
        self.start_mag(delay)
    }

    fn scale(&self) -> Scale {
        self.settings.scale
    }
}
