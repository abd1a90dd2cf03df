//! ICM-20948: nine axes in one chip, read with one burst.
//!
//! Source: TDK InvenSense DS-000189 rev. 1.3. The inertial die and an AK09916 magnetometer share the
//! package; the magnetometer hangs on the chip's own auxiliary I²C bus. The internal bus master is
//! told once to fetch its nine status and data bytes (ST1 0x10 … ST2 0x18, p. 77) after every
//! gyroscope conversion into EXT_SLV_SENS_DATA, which follows the inertial data in the register map:
//!
//! ```text
//! 0x2D acc x y z | 0x33 gyr x y z | 0x39 temp | 0x3B ST1 | 0x3C mag x y z | 0x42 TMPS | 0x43 ST2
//!      6 bytes BE |     6 bytes BE |  2 bytes |  1       |   6 bytes LE   |  1 (zero) |  1
//! ```
//!
//! so one 23-byte burst is a complete, consistent sample (burst reads: p. 30). Reading up to ST2 also
//! releases the magnetometer's data latch (p. 79). Traps met on the way:
//!
//! * LP_CONFIG starts as 0x40: the internal master is duty-cycled (p. 37). It is cleared here.
//! * The AK09916 does not see the inertial die's reset: it gets its own (CNTL3.SRST).
//! * DELAY_ES_SHADOW keeps half-fetched magnetometer bytes out of the burst.
//! * The magnetometer's y and z run against the other sensors' ([`Axes::AK09916`], orientation of axes).
//! * Its zero may be off by ±2000 counts = ±300 µT (p. 13): useless before calibration.

use super::port::Port;
use super::{Axes, ConfigError, Identity, Imu, ImuError, Part, RawImu, STANDARD_GRAVITY_M_S2, Scale};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use serde::{Deserialize, Serialize};

/// Register addresses, bank by bank (DS-000189 chapter 7; p. 77 for the AK09916).
pub mod reg {
    /// Any bank: bits 5:4 select the bank.
    pub const BANK_SEL: u8 = 0x7F;
    /// Bank 0: identity.
    pub const WHO_AM_I: u8 = 0x00;
    /// Bank 0: internal master on and reset.
    pub const USER_CTRL: u8 = 0x03;
    /// Bank 0: duty cycling.
    pub const LP_CONFIG: u8 = 0x05;
    /// Bank 0: reset, sleep, clock.
    pub const PWR_MGMT_1: u8 = 0x06;
    /// Bank 0: axes on and off.
    pub const PWR_MGMT_2: u8 = 0x07;
    /// Bank 0: bypass of the internal bus.
    pub const INT_PIN_CFG: u8 = 0x0F;
    /// Bank 0: what the internal master did.
    pub const I2C_MST_STATUS: u8 = 0x17;
    /// Bank 0: first byte of the burst.
    pub const ACCEL_XOUT_H: u8 = 0x2D;
    /// Bank 0: first byte of temperature.
    pub const TEMP_OUT_H: u8 = 0x39;
    /// Bank 0: first byte fetched from the magnetometer.
    pub const EXT_SLV_SENS_DATA_00: u8 = 0x3B;
    /// Bank 2: gyroscope rate divider.
    pub const GYRO_SMPLRT_DIV: u8 = 0x00;
    /// Bank 2: gyroscope range and filter.
    pub const GYRO_CONFIG_1: u8 = 0x01;
    /// Bank 2: start both sensors' conversions together.
    pub const ODR_ALIGN_EN: u8 = 0x09;
    /// Bank 2: accelerometer rate divider, high byte.
    pub const ACCEL_SMPLRT_DIV_1: u8 = 0x10;
    /// Bank 2: accelerometer rate divider, low byte.
    pub const ACCEL_SMPLRT_DIV_2: u8 = 0x11;
    /// Bank 2: accelerometer range and filter.
    pub const ACCEL_CONFIG: u8 = 0x14;
    /// Bank 3: internal master's rate when the gyroscope is off.
    pub const I2C_MST_ODR_CONFIG: u8 = 0x00;
    /// Bank 3: internal master's clock.
    pub const I2C_MST_CTRL: u8 = 0x01;
    /// Bank 3: shadowing of fetched bytes.
    pub const I2C_MST_DELAY_CTRL: u8 = 0x02;
    /// Bank 3: first of the four registers (address, register, control, data out) of slave 0.
    pub const I2C_SLV0_ADDR: u8 = 0x03;
    /// Bank 3: slave 0 start register.
    pub const I2C_SLV0_REG: u8 = 0x04;
    /// Bank 3: slave 0 enable and length.
    pub const I2C_SLV0_CTRL: u8 = 0x05;
    /// Bank 3: one-shot slave address.
    pub const I2C_SLV4_ADDR: u8 = 0x13;
    /// Bank 3: one-shot slave register.
    pub const I2C_SLV4_REG: u8 = 0x14;
    /// Bank 3: one-shot slave go.
    pub const I2C_SLV4_CTRL: u8 = 0x15;
    /// Bank 3: one-shot slave data out.
    pub const I2C_SLV4_DO: u8 = 0x16;
    /// Bank 3: one-shot slave data in.
    pub const I2C_SLV4_DI: u8 = 0x17;
    /// AK09916: identity.
    pub const AK_WIA2: u8 = 0x01;
    /// AK09916: data ready and overrun.
    pub const AK_ST1: u8 = 0x10;
    /// AK09916: overflow; ends a reading.
    pub const AK_ST2: u8 = 0x18;
    /// AK09916: mode.
    pub const AK_CNTL2: u8 = 0x31;
    /// AK09916: soft reset.
    pub const AK_CNTL3: u8 = 0x32;
}

/// Content of WHO_AM_I (DS-000189, 8.1).
pub const WHO_AM_I: u8 = 0xEA;
/// Content of the AK09916's WIA2 (p. 78).
pub const AK_WHO_AM_I: u8 = 0x09;
/// Address of the AK09916 on the internal bus (and outside, in bypass).
pub const AK_ADDRESS: u8 = 0x0C;
/// Base conversion rate of both inertial sensors with their filters on, Hz.
pub const BASE_RATE_HZ: f64 = 1125.0;
const BURST: usize = 23;
const SLV4_LIMIT_MS: u32 = 20;
const RESET_LIMIT_MS: u32 = 100;
const MAG_TRIES: u32 = 5;

/// Gyroscope filters: 3 dB bandwidth by GYRO_DLPFCFG 0 to 7 (DS-000189, table of GYRO_CONFIG_1).
const GYRO_BANDWIDTH_HZ: [f64; 8] = [196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4];
/// Accelerometer filters by ACCEL_DLPFCFG 0 to 7 (table of ACCEL_CONFIG); 0 equals 1.
const ACC_BANDWIDTH_HZ: [f64; 8] = [246.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7, 473.0];

/// Settings of an ICM-20948.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// 7-bit bus address: 104 (0x68) with the AD0 pin low, 105 (0x69) with it high. Default 104.
    /// A second sensor on the same bus takes the other one.
    pub address: u8,

    /// Full scale of the gyroscope, °/s: 250, 500, 1000 or 2000. Default 500, four times the fastest
    /// bend. A bigger range survives jerks and costs resolution (500 is 0.015 °/s a count).
    pub gyro_range_dps: u16,

    /// Full scale of the accelerometer, g: 2, 4, 8 or 16. Default 4. A bigger range survives knocks
    /// and costs resolution (4 g is 0.12 mg a count).
    pub acc_range_g: u8,

    /// Readings a second that the loop will make, Hz, 4.4 to 1125. Default 500. The chip converts at
    /// the next rate 1125 / (1 + n) Hz that is not slower (here 562.5), so no conversion is read
    /// twice.
    pub rate_hz: f64,

    /// Narrowest gyroscope filter allowed, Hz, up to 361. Default 100: the chip takes the next wider
    /// of 5.7, 11.6, 23.9, 51.2, 119.5, 151.8, 196.6 and 361.4. A bigger value lets more noise and
    /// less delay through.
    pub gyro_bandwidth_hz: f64,

    /// Narrowest accelerometer filter allowed, Hz, up to 473. Default 50: the next wider of 5.7,
    /// 11.5, 23.9, 50.4, 111.4, 246 and 473 is taken.
    pub acc_bandwidth_hz: f64,

    /// Measurements a second of the magnetometer, Hz: 10, 20, 50 or 100. Default 100.
    pub mag_rate_hz: u16,

    /// Readings between two checks that the chip still has its settings; 0 never checks. Default 50,
    /// ten times a second at 500 Hz. A smaller value finds a restart sooner and costs bus time: a
    /// check takes up to 0.5 ms.
    pub canary_every: u16,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            address: 0x68,
            gyro_range_dps: 500,
            acc_range_g: 4,
            rate_hz: 500.0,
            gyro_bandwidth_hz: 100.0,
            acc_bandwidth_hz: 50.0,
            mag_rate_hz: 100,
            canary_every: 50,
        }
    }
}

/// A configuration in the chip's own terms, compiled once by [`Config::settings`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    address: u8,
    divider: u8,
    gyro_config: u8,
    acc_config: u8,
    mag_mode: u8,
    mag_rate_hz: f64,
    canary_every: u16,
    scale: Scale,
}

/// Position of the narrowest filter that is at least `wanted` wide.
fn filter(table: &[f64; 8], wanted: f64) -> Option<u8> {
    (0..8_u8)
        .filter(|i| table[usize::from(*i)] >= wanted)
        .min_by(|a, b| table[usize::from(*a)].total_cmp(&table[usize::from(*b)]).then(b.cmp(a)))
}

impl Config {
    /// Checks the settings and translates them.
    ///
    /// # Errors
    /// The first setting that the part does not have.
    pub fn settings(&self) -> Result<Settings, ConfigError> {
        let no = |field, value, allowed| ConfigError { part: Part::Icm20948, field, value, allowed };
        let range = |list: &[u16], have: u16| (0_u8..).zip(list).find(|(_, x)| **x == have).map(|(i, _)| i);
        if !matches!(self.address, 0x68 | 0x69) {
            return Err(no("address", f64::from(self.address), "104 (0x68) or 105 (0x69)"));
        }
        let gyro_fs = range(&[250, 500, 1000, 2000], self.gyro_range_dps)
            .ok_or(no("gyro_range_dps", f64::from(self.gyro_range_dps), "250, 500, 1000 or 2000"))?;
        let acc_fs = range(&[2, 4, 8, 16], u16::from(self.acc_range_g))
            .ok_or(no("acc_range_g", f64::from(self.acc_range_g), "2, 4, 8 or 16"))?;
        let mag_mode = range(&[10, 20, 50, 100], self.mag_rate_hz)
            .ok_or(no("mag_rate_hz", f64::from(self.mag_rate_hz), "10, 20, 50 or 100"))?;
        if !(4.4..=BASE_RATE_HZ).contains(&self.rate_hz) {
            return Err(no("rate_hz", self.rate_hz, "4.4 to 1125"));
        }
        let gyro_dlpf = filter(&GYRO_BANDWIDTH_HZ, self.gyro_bandwidth_hz)
            .ok_or(no("gyro_bandwidth_hz", self.gyro_bandwidth_hz, "at most 361.4"))?;
        let acc_dlpf = filter(&ACC_BANDWIDTH_HZ, self.acc_bandwidth_hz)
            .ok_or(no("acc_bandwidth_hz", self.acc_bandwidth_hz, "at most 473"))?;
        Ok(Settings {
            address: self.address,
            divider: ((BASE_RATE_HZ / self.rate_hz).floor() - 1.0) as u8,
            gyro_config: gyro_dlpf << 3 | gyro_fs << 1 | 1,
            acc_config: acc_dlpf << 3 | acc_fs << 1 | 1,
            mag_mode: (mag_mode + 1) << 1,
            mag_rate_hz: f64::from(self.mag_rate_hz),
            canary_every: self.canary_every,
            scale: scale(gyro_fs, acc_fs),
        })
    }
}

/// SI value of a count for FS_SEL fields. The sheet lists 131, 65.5, 32.8 and 16.4 LSB/(°/s) and
/// 16384 … 2048 LSB/g (tables 1 and 2); temperature is 333.87 LSB/°C around 21 °C, the field
/// 0.15 µT/LSB (table 3, p. 13).
#[must_use]
pub fn scale(gyro_fs: u8, acc_fs: u8) -> Scale {
    let gyro_lsb_per_dps = [131.0, 65.5, 32.8, 16.4][usize::from(gyro_fs & 3)];
    let acc_lsb_per_g = f64::from(16384_u16 >> (acc_fs & 3));
    Scale {
        gyro_rad_s: 1.0_f64.to_radians() / gyro_lsb_per_dps,
        acc_m_s2: STANDARD_GRAVITY_M_S2 / acc_lsb_per_g,
        mag_ut: 0.15,
        mag_axes: Axes::AK09916,
        temp_c: 1.0 / 333.87,
        temp_zero_c: 21.0,
    }
}

/// Driver. `I` is a bus handle of its own.
#[derive(Debug)]
pub struct Icm20948<I> {
    bus: I,
    port: Port,
    settings: Settings,
    ready: bool,
    reads: u16,
    ranges_next: bool,
    last: Option<RawImu>,
    last_mag: Option<[i16; 3]>,
}

impl<I: I2c> Icm20948<I> {
    /// A driver that has not talked to its chip yet.
    ///
    /// # Errors
    /// [`ConfigError`] for a setting that the part does not have.
    pub fn new(bus: I, config: &Config) -> Result<Self, ConfigError> {
        let settings = config.settings()?;
        let port = Port { part: Part::Icm20948, address: settings.address };
        Ok(Self { bus, port, settings, ready: false, reads: 0, ranges_next: false, last: None, last_mag: None })
    }

    /// Gives the bus back.
    pub fn release(self) -> I {
        self.bus
    }

    fn set(&mut self, register: u8, value: u8) -> Result<(), ImuError> {
        self.port.set(&mut self.bus, register, value)
    }

    fn bank(&mut self, bank: u8) -> Result<(), ImuError> {
        self.set(reg::BANK_SEL, bank << 4)
    }

    fn reset(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.set(reg::PWR_MGMT_1, 0x80)?;
        delay.delay_ms(10);
        let busy = (reg::PWR_MGMT_1, 0x80);
        self.port.wait_clear(&mut self.bus, delay, busy, "its reset", RESET_LIMIT_MS)?;
        self.set(reg::PWR_MGMT_1, 0x01)?; // awake, best clock
        delay.delay_ms(35); // gyroscope start-up (DS-000189, table 1)
        self.set(reg::PWR_MGMT_2, 0x00)?;
        self.set(reg::LP_CONFIG, 0x00)?;
        self.set(reg::INT_PIN_CFG, 0x00)
    }

    fn ranges(&mut self) -> Result<(), ImuError> {
        let s = self.settings;
        self.bank(2)?;
        self.set(reg::ODR_ALIGN_EN, 0x01)?;
        self.set(reg::GYRO_SMPLRT_DIV, s.divider)?;
        self.set(reg::GYRO_CONFIG_1, s.gyro_config)?;
        self.set(reg::ACCEL_SMPLRT_DIV_1, 0x00)?;
        self.set(reg::ACCEL_SMPLRT_DIV_2, s.divider)?;
        self.set(reg::ACCEL_CONFIG, s.acc_config)?;
        self.bank(0)
    }

    fn start_master(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        self.set(reg::USER_CTRL, 0x02)?; // internal master reset, clears itself
        delay.delay_ms(2);
        self.set(reg::USER_CTRL, 0x20)?; // internal master on
        self.bank(3)?;
        self.set(reg::I2C_MST_CTRL, 0x17)?; // stop between reads, 345.6 kHz
        self.set(reg::I2C_MST_DELAY_CTRL, 0x80)?; // DELAY_ES_SHADOW
        self.bank(0)
    }

    /// One byte to or from the magnetometer through the one-shot slave.
    fn aux(&mut self, delay: &mut dyn DelayNs, register: u8, write: Option<u8>) -> Result<u8, ImuError> {
        self.port.get(&mut self.bus, reg::I2C_MST_STATUS)?; // reading clears what was left in it
        self.bank(3)?;
        self.set(reg::I2C_SLV4_ADDR, AK_ADDRESS | if write.is_some() { 0 } else { 0x80 })?;
        self.set(reg::I2C_SLV4_REG, register)?;
        self.set(reg::I2C_SLV4_DO, write.unwrap_or(0))?;
        self.set(reg::I2C_SLV4_CTRL, 0x80)?;
        self.bank(0)?;
        for _ in 0..SLV4_LIMIT_MS {
            delay.delay_ms(1);
            let status = self.port.get(&mut self.bus, reg::I2C_MST_STATUS)?;
            if status & 0x10 != 0 {
                return Err(ImuError::Nack { part: Part::Ak09916, address: AK_ADDRESS });
            }
            if status & 0x40 != 0 {
                self.bank(3)?;
                let value = self.port.get(&mut self.bus, reg::I2C_SLV4_DI)?;
                self.bank(0)?;
                return Ok(value);
            }
        }
        Err(ImuError::Timeout { part: Part::Ak09916, what: "a transfer", limit_ms: SLV4_LIMIT_MS })
    }

    /// Resets and identifies the magnetometer. It may miss the first transfers after power-up, so
    /// the internal master is restarted between tries.
    fn find_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        let mut last = Ok(());
        for _ in 0..MAG_TRIES {
            self.start_master(delay)?;
            last = self.aux(delay, reg::AK_CNTL3, Some(0x01)).and_then(|_| {
                delay.delay_ms(2);
                match self.aux(delay, reg::AK_WIA2, None)? {
                    AK_WHO_AM_I => Ok(()),
                    have => {
                        let (part, address, want) = (Part::Ak09916, AK_ADDRESS, AK_WHO_AM_I);
                        Err(ImuError::WrongId { part, address, have, want })
                    }
                }
            });
            if last.is_ok() {
                break;
            }
            delay.delay_ms(5);
        }
        last
    }

    fn start_mag(&mut self, delay: &mut dyn DelayNs) -> Result<(), ImuError> {
        let want = self.settings.mag_mode;
        self.aux(delay, reg::AK_CNTL2, Some(want))?;
        let have = self.aux(delay, reg::AK_CNTL2, None)?;
        if have != want {
            return Err(ImuError::ResetToDefaults { part: Part::Ak09916, register: reg::AK_CNTL2, have, want });
        }
        self.bank(3)?;
        self.set(reg::I2C_SLV0_ADDR, 0x80 | AK_ADDRESS)?;
        self.set(reg::I2C_SLV0_REG, reg::AK_ST1)?;
        self.set(reg::I2C_SLV0_CTRL, 0x80 | 9)?;
        self.bank(0)
    }

    /// Every `canary_every` readings, power settings and ranges in turn.
    fn canary(&mut self, suspicious: bool) -> Result<(), ImuError> {
        self.reads = self.reads.wrapping_add(1);
        let due = self.settings.canary_every != 0 && self.reads >= self.settings.canary_every;
        if due {
            self.reads = 0;
            self.ranges_next = !self.ranges_next;
        }
        if suspicious || (due && self.ranges_next) {
            // USER_CTRL, 0x04 (reserved), LP_CONFIG, PWR_MGMT_1, PWR_MGMT_2
            let want = [(0x20, 0xFF), (0, 0), (0x00, 0x70), (0x01, 0xEF), (0x00, 0x3F)];
            self.port.check(&mut self.bus, reg::USER_CTRL, &want)
        } else if due {
            let s = self.settings;
            self.bank(2)?;
            self.port.check(&mut self.bus, reg::GYRO_SMPLRT_DIV, &[(s.divider, 0xFF), (s.gyro_config, 0x3F)])?;
            self.port.check(&mut self.bus, reg::ACCEL_CONFIG, &[(s.acc_config, 0x3F)])?;
            self.bank(0)
        } else {
            Ok(())
        }
    }

    fn burst(&mut self) -> Result<RawImu, ImuError> {
        let mut b = [0_u8; BURST];
        self.port.read(&mut self.bus, reg::ACCEL_XOUT_H, &mut b)?;
        // TMPS and ST2 have bits that are always 0; all ones means the chip let go of the line
        if b[BURST - 2..] == [0xFF, 0xFF] {
            return Err(self.port.short(&b));
        }
        Ok(decode(&b, &mut self.last_mag))
    }

    fn read_checked(&mut self) -> Result<RawImu, ImuError> {
        let mut raw = self.burst()?;
        let blank = raw.acc == [0; 3] && raw.gyro == [0; 3]; // what a sleeping chip shows
        self.canary(blank)?;
        raw.fresh = self.last.is_none_or(|l| (l.gyro, l.acc) != (raw.gyro, raw.acc));
        self.last = Some(raw);
        Ok(raw)
    }
}

/// Takes the burst apart. A magnetometer value is new when data-ready was seen with it, or when it
/// changed (after the reset: from zero): the internal master may have polled, and cleared data-ready,
/// between two bursts.
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
        let inertial = self.port.identify(&mut self.bus, reg::WHO_AM_I, WHO_AM_I)?;
        self.reset(delay)?;
        self.ranges()?;
        self.find_mag(delay)?;
        self.start_mag(delay)?;
        delay.delay_ms(10); // first magnetometer measurement
        self.ready = true;
        Ok(Identity {
            inertial,
            magnetic: super::ChipId { part: Part::Ak09916, address: AK_ADDRESS, id: AK_WHO_AM_I },
            rate_hz: BASE_RATE_HZ / (1.0 + f64::from(self.settings.divider)),
            mag_rate_hz: self.settings.mag_rate_hz,
        })
    }

    fn read(&mut self) -> Result<RawImu, ImuError> {
        if !self.ready {
            return Err(ImuError::NotReady { part: Part::Icm20948 });
        }
        let result = self.read_checked();
        match result {
            Err(ImuError::ResetToDefaults { .. }) => self.ready = false,
            // the fault may have struck while another bank was selected; if this fails too, the
            // next reading meets the same bus
            Err(_) => drop(self.bank(0)),
            Ok(_) => {}
        }
        result
    }

    fn scale(&self) -> Scale {
        self.settings.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_the_register_fields() {
        let s = Config::default().settings().expect("default");
        assert_eq!(s.divider, 1, "562.5 Hz is the next rate above 500");
        assert_eq!(s.gyro_config, 2 << 3 | 1 << 1 | 1, "119.5 Hz, 500 dps");
        assert_eq!(s.acc_config, 3 << 3 | 1 << 1 | 1, "50.4 Hz, 4 g");
        assert_eq!(s.mag_mode, 0x08, "continuous mode 4");
        let fast = Config { rate_hz: 1125.0, gyro_bandwidth_hz: 300.0, ..Config::default() };
        let s = fast.settings().expect("fast");
        assert_eq!((s.divider, s.gyro_config >> 3), (0, 7));
    }

    #[test]
    fn settings_name_what_is_wrong() {
        let bad = [
            (Config { address: 0x42, ..Config::default() }, "address"),
            (Config { gyro_range_dps: 300, ..Config::default() }, "gyro_range_dps"),
            (Config { acc_range_g: 3, ..Config::default() }, "acc_range_g"),
            (Config { rate_hz: 2000.0, ..Config::default() }, "rate_hz"),
            (Config { rate_hz: f64::NAN, ..Config::default() }, "rate_hz"),
            (Config { gyro_bandwidth_hz: 400.0, ..Config::default() }, "gyro_bandwidth_hz"),
            (Config { acc_bandwidth_hz: f64::NAN, ..Config::default() }, "acc_bandwidth_hz"),
            (Config { mag_rate_hz: 75, ..Config::default() }, "mag_rate_hz"),
        ];
        for (config, field) in bad {
            let error = config.settings().expect_err(field);
            assert!(error.to_string().contains(&format!("`imu.{field}`")), "{error}");
        }
    }

    #[test]
    fn every_rate_is_met_or_exceeded_by_the_slowest_that_does() {
        for rate_hz in [4.4, 10.0, 100.0, 225.0, 226.0, 499.0, 562.5, 563.0, 1125.0] {
            let s = Config { rate_hz, ..Config::default() }.settings().expect("in range");
            let odr = |n: u8| BASE_RATE_HZ / (1.0 + f64::from(n));
            assert!(odr(s.divider) >= rate_hz - 1e-9, "{rate_hz}");
            assert!(s.divider == 255 || odr(s.divider + 1) < rate_hz, "{rate_hz}");
        }
    }
}
