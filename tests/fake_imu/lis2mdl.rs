//! Register machine of the LIS2MDL (DS12144): idle until set to continuous mode; its address counter
//! repeats over the six data bytes.

use super::{Analog, Device, Motion, Noise, Quirks, Ticker};
use retroflex::hardware::imu::Axes;
use retroflex::hardware::imu::lis2mdl::{ADDRESS, UT_PER_LSB, WHO_AM_I, reg};

/// First and last data byte.
const OUTX_L: u8 = 0x68;
const OUTZ_H: u8 = 0x6D;
const STATUS_NEW: u8 = 0x0F;
const STATUS_OVERRUN: u8 = 0xF0;

/// Magnetometer at 0x1E.
#[derive(Debug)]
pub struct FakeLis2mdl {
    regs: [u8; 128],
    pointer: u8,
    axes: Axes,
    ticker: Ticker,
    analog: Analog,
}

impl FakeLis2mdl {
    /// A chip fresh from power-up, mounted along the accelerometer's axes.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self::mounted(Axes::ALIGNED, seed)
    }

    /// A chip in another orientation: `axes` convert its axes to the accelerometer's.
    #[must_use]
    pub fn mounted(axes: Axes, seed: u64) -> Self {
        let (ticker, analog) = (Ticker::default(), Analog::new(seed));
        let mut fake = Self {
            regs: [0; 128],
            pointer: 0,
            axes,
            ticker,
            analog,
        };
        fake.brown_out();
        fake
    }

    fn get(&self, register: u8) -> u8 {
        self.regs[usize::from(register)]
    }

    fn defaults(&mut self) {
        self.regs = [0; 128];
        self.regs[usize::from(reg::CFG_REG_A)] = 0x03; // idle
        self.ticker = Ticker::default();
    }

    /// A write: register, then data with automatic increment.
    pub fn write(&mut self, bytes: &[u8]) {
        let Some((&register, data)) = bytes.split_first() else {
            return;
        };
        self.pointer = register & 0x7F;
        for &value in data {
            match self.pointer {
                reg::CFG_REG_A if value & 0x20 != 0 => self.defaults(),
                reg::WHO_AM_I | reg::STATUS..=0x6F => {} // read-only
                r => self.regs[usize::from(r)] = value,
            }
            self.step();
        }
    }

    /// A read from the present register on; data clear the new-data bits.
    pub fn read(&mut self, out: &mut [u8]) {
        for byte in out {
            *byte = match self.pointer {
                reg::WHO_AM_I => self.analog.quirks.wrong_id.unwrap_or(WHO_AM_I),
                r => self.get(r),
            };
            if self.pointer == OUTZ_H {
                self.regs[usize::from(reg::STATUS)] = 0;
            }
            self.step();
        }
    }

    fn step(&mut self) {
        self.pointer = match self.pointer {
            OUTZ_H => OUTX_L,
            p => p.wrapping_add(1) & 0x7F,
        };
    }

    fn measure(&mut self) {
        let field = super::to_chip(&self.axes, &self.analog.motion.mag_ut);
        let mut counts = self
            .analog
            .counts(field, self.analog.noise.mag_ut, UT_PER_LSB);
        if self.analog.quirks.mag_overflow {
            counts = [i16::MAX; 3];
        }
        for (i, c) in counts.into_iter().enumerate() {
            self.regs[usize::from(OUTX_L) + 2 * i..][..2].copy_from_slice(&c.to_le_bytes());
        }
        let status = &mut self.regs[usize::from(reg::STATUS)];
        *status = if *status & STATUS_NEW != 0 {
            STATUS_NEW | STATUS_OVERRUN
        } else {
            STATUS_NEW
        };
    }
}

impl Device for FakeLis2mdl {
    fn answers(&self, address: u8) -> bool {
        address == ADDRESS
    }
    fn write(&mut self, _: u8, bytes: &[u8]) {
        Self::write(self, bytes);
    }
    fn read(&mut self, _: u8, out: &mut [u8]) {
        Self::read(self, out);
    }
    fn advance(&mut self, dt_s: f64) {
        let control = self.get(reg::CFG_REG_A);
        let rate_hz = [10.0, 20.0, 50.0, 100.0][usize::from(control >> 2 & 3)];
        let converting = control & 0x03 == 0 && !self.analog.quirks.frozen;
        if converting && self.ticker.due(dt_s, 1.0 / rate_hz) {
            self.measure();
        }
    }
    fn set_motion(&mut self, motion: &Motion) {
        self.analog.motion = *motion;
    }
    fn set_noise(&mut self, noise: Noise) {
        self.analog.noise = noise;
    }
    fn brown_out(&mut self) {
        self.defaults();
        self.pointer = 0;
    }
    fn quirks(&mut self) -> &mut Quirks {
        &mut self.analog.quirks
    }
}
