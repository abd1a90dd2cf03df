//! Register machine of the AK09916 (DS-000189 rev. 1.3, p. 77-80), as it appears on the internal bus.

use super::{Analog, Ticker};
use retroflex::hardware::imu::Axes;
use retroflex::hardware::imu::icm20948::{AK_WHO_AM_I, reg};

const UT_PER_LSB: f64 = 0.15;
const HXL: u8 = 0x11;
/// Overflow; reading it ends a measurement read.
const ST2: u8 = 0x18;
const DRDY: u8 = 0x01;
const DOR: u8 = 0x02;
const HOFL: u8 = 0x08;
/// Largest count: the converter stops at ±4912 µT.
const COUNT_MAX: i16 = 32752;

/// The magnetometer die.
#[derive(Debug)]
pub struct FakeAk09916 {
    regs: [u8; 0x35],
    pointer: u8,
    ticker: Ticker,
    latched: bool,
}

impl Default for FakeAk09916 {
    /// Fresh from power-up.
    fn default() -> Self {
        let mut regs = [0; 0x35];
        regs[0] = 0x48; // company
        regs[usize::from(reg::AK_WIA2)] = AK_WHO_AM_I;
        Self {
            regs,
            pointer: 0,
            ticker: Ticker::default(),
            latched: false,
        }
    }
}

impl FakeAk09916 {
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Seconds between measurements; `None` in power-down.
    fn period_s(&self) -> Option<f64> {
        match self.regs[usize::from(reg::AK_CNTL2)] & 0x1F {
            0x01 => Some(0.0072), // single: one measurement time, then power-down
            0x02 => Some(0.1),
            0x04 => Some(0.05),
            0x06 => Some(0.02),
            0x08 => Some(0.01),
            _ => None,
        }
    }

    pub(super) fn advance(&mut self, dt_s: f64, analog: &mut Analog) {
        let Some(period_s) = self.period_s() else {
            return;
        };
        if !self.ticker.due(dt_s, period_s) || analog.quirks.frozen {
            return;
        }
        if self.regs[usize::from(reg::AK_CNTL2)] == 0x01 {
            self.regs[usize::from(reg::AK_CNTL2)] = 0;
        }
        let st1 = usize::from(reg::AK_ST1);
        if self.latched {
            self.regs[st1] |= DOR; // being read: the measurement is lost
            return;
        }
        let field = super::to_chip(&Axes::AK09916, &analog.motion.mag_ut);
        let counts = analog.counts(field, analog.noise.mag_ut, UT_PER_LSB);
        let strong = field.iter().map(|x| x.abs()).sum::<f64>() > 4912.0;
        let over = strong || analog.quirks.mag_overflow;
        for (i, c) in counts.into_iter().enumerate() {
            let c = c.clamp(-COUNT_MAX, COUNT_MAX);
            self.regs[usize::from(HXL) + 2 * i..][..2].copy_from_slice(&c.to_le_bytes());
        }
        self.regs[usize::from(ST2)] = if over { HOFL } else { 0 };
        self.regs[st1] = if self.regs[st1] & DRDY != 0 {
            DRDY | DOR
        } else {
            DRDY
        };
    }

    /// A write: register, then data with automatic increment.
    pub fn write(&mut self, bytes: &[u8]) {
        let Some((&register, data)) = bytes.split_first() else {
            return;
        };
        self.pointer = register;
        for &value in data {
            match self.pointer {
                reg::AK_CNTL3 if value & 1 != 0 => self.reset(),
                reg::AK_CNTL2 => {
                    self.regs[usize::from(reg::AK_CNTL2)] = value & 0x1F;
                    self.ticker = Ticker::default();
                }
                _ => {}
            }
            self.step();
        }
    }

    /// A read from the present register on. Data registers clear data-ready and latch the data until
    /// ST2 has been read.
    pub fn read(&mut self, out: &mut [u8]) {
        for byte in out {
            *byte = self
                .regs
                .get(usize::from(self.pointer))
                .copied()
                .unwrap_or(0);
            match self.pointer {
                ST2 => {
                    self.latched = false;
                    self.regs[usize::from(reg::AK_ST1)] = 0;
                }
                HXL..ST2 => {
                    self.latched = true;
                    self.regs[usize::from(reg::AK_ST1)] = 0;
                }
                _ => {}
            }
            self.step();
        }
    }

    /// Address counter: 0x00 to 0x03, on to 0x10 to 0x18, round to 0x00; 0x30 to 0x32 in a ring.
    fn step(&mut self) {
        self.pointer = match self.pointer {
            0x03 => 0x10,
            0x18 => 0x00,
            0x32 => 0x30,
            p => p.wrapping_add(1),
        };
    }
}
