//! Register machine of the LSM6DSO (DS12140) and the LSM6DSV16X: power-down until a rate is set, reset, new-data bits.

use super::{Analog, Device, Motion, Noise, Quirks, Ticker};
use retroflex::hardware::imu::Axes;
use retroflex::hardware::imu::lsm6dso::{RATES_HZ, Variant, reg, scale};

/// First bytes of temperature, rate and force.
const OUT_TEMP_L: u8 = 0x20;
const OUTX_L_G: u8 = 0x22;
const OUTX_L_A: u8 = 0x28;
const STATUS_ACC: u8 = 0x01;
const STATUS_GYRO: u8 = 0x02;
const STATUS_TEMP: u8 = 0x04;
const RESET_TIME_S: f64 = 50e-6;

/// Gyroscope and accelerometer at 0x6A or 0x6B.
#[derive(Debug)]
pub struct FakeLsm6dso {
    variant: Variant,
    address: u8,
    regs: [u8; 128],
    pointer: u8,
    gyro: Ticker,
    acc: Ticker,
    reset_s: f64,
    analog: Analog,
}

impl FakeLsm6dso {
    /// A chip fresh from power-up; the seed is that of its noise.
    #[must_use]
    pub fn new(address: u8, seed: u64) -> Self {
        Self::of(Variant::Dso, address, seed)
    }

    /// One of the parts.
    #[must_use]
    pub fn of(variant: Variant, address: u8, seed: u64) -> Self {
        let mut fake = Self {
            variant,
            address,
            regs: [0; 128],
            pointer: 0,
            gyro: Ticker::default(),
            acc: Ticker::default(),
            reset_s: 0.0,
            analog: Analog::new(seed),
        };
        fake.brown_out();
        fake
    }

    fn get(&self, register: u8) -> u8 {
        self.regs[usize::from(register)]
    }

    /// Period of an ODR field; `None` in power-down.
    fn period_s(&self, control: u8) -> Option<f64> {
        if self.variant == Variant::Dsv16x {
            // code 1 is 1.875 Hz, code 2 is 7.5 Hz, and each further one doubles it
            return match control & 0x0F {
                0 => None,
                1 => Some(1.0 / 1.875),
                code => Some(1.0 / (7.5 * f64::from(1_u32 << (code - 2)))),
            };
        }
        let code = usize::from(control >> 4);
        RATES_HZ.get(code.wrapping_sub(1)).map(|hz| 1.0 / hz)
    }

    fn put(&mut self, from: u8, counts: &[i16]) {
        for (i, c) in counts.iter().enumerate() {
            self.regs[usize::from(from) + 2 * i..][..2].copy_from_slice(&c.to_le_bytes());
        }
    }

    fn convert(&mut self, dt_s: f64) {
        let (ctrl1, ctrl2) = (self.get(reg::CTRL1), self.get(reg::CTRL2));
        let gyro_due = self.period_s(ctrl2).is_some_and(|p| self.gyro.due(dt_s, p));
        let acc_due = self.period_s(ctrl1).is_some_and(|p| self.acc.due(dt_s, p));
        if !(gyro_due || acc_due) || self.analog.quirks.frozen {
            return;
        }
        let (gyro_dps, acc_g) = match self.variant {
            Variant::Dso if ctrl2 & 0x02 != 0 => (125, [2, 16, 4, 8][usize::from(ctrl1 >> 2 & 3)]),
            Variant::Dso => (
                250 << (ctrl2 >> 2 & 3),
                [2, 16, 4, 8][usize::from(ctrl1 >> 2 & 3)],
            ),
            Variant::Dsv16x => (
                125 << (self.get(reg::CTRL6) & 0x0F),
                2 << (self.get(reg::CTRL8) & 0x03),
            ),
        };
        let unit = scale(gyro_dps, acc_g, Axes::ALIGNED);
        let (gyro, acc) = self.analog.inertial(unit.gyro_rad_s, unit.acc_m_s2);
        let temp = ((self.analog.motion.temp_c - unit.temp_zero_c) / unit.temp_c).round() as i16;
        let mut status = self.get(reg::STATUS_REG) | STATUS_TEMP;
        if gyro_due {
            self.put(OUTX_L_G, &gyro);
            status |= STATUS_GYRO;
        }
        if acc_due {
            self.put(OUTX_L_A, &acc);
            status |= STATUS_ACC;
        }
        self.put(OUT_TEMP_L, &[temp]);
        self.regs[usize::from(reg::STATUS_REG)] = status;
    }

    /// A write: register, then data; the address moves on while IF_INC is set.
    pub fn write(&mut self, bytes: &[u8]) {
        let Some((&register, data)) = bytes.split_first() else {
            return;
        };
        self.pointer = register & 0x7F;
        for &value in data {
            match self.pointer {
                reg::CTRL3 if value & 0x01 != 0 => {
                    self.defaults();
                    self.reset_s = RESET_TIME_S;
                }
                reg::WHO_AM_I | reg::STATUS_REG..=0x2D => {} // read-only
                r => self.regs[usize::from(r)] = value,
            }
            self.step();
        }
    }

    /// A read from the present register on; data clear their new-data bit.
    pub fn read(&mut self, out: &mut [u8]) {
        for byte in out {
            *byte = match self.pointer {
                reg::WHO_AM_I => self.analog.quirks.wrong_id.unwrap_or(match self.variant {
                    Variant::Dso => 0x6C,
                    Variant::Dsv16x => 0x70,
                }),
                reg::CTRL3 if self.reset_s > 0.0 => self.get(reg::CTRL3) | 0x01,
                r => self.get(r),
            };
            let read = match self.pointer {
                0x21 => STATUS_TEMP,
                0x23 | 0x25 | 0x27 => STATUS_GYRO,
                0x29 | 0x2B | 0x2D => STATUS_ACC,
                _ => 0,
            };
            self.regs[usize::from(reg::STATUS_REG)] &= !read;
            self.step();
        }
    }

    fn step(&mut self) {
        if self.get(reg::CTRL3) & 0x04 != 0 {
            self.pointer = self.pointer.wrapping_add(1) & 0x7F;
        }
    }

    fn defaults(&mut self) {
        self.regs = [0; 128];
        self.regs[usize::from(reg::CTRL3)] = 0x04;
        if self.variant == Variant::Dso {
            self.regs[usize::from(reg::CTRL9)] = 0xE0;
        }
        (self.gyro, self.acc) = Default::default();
    }
}

impl Device for FakeLsm6dso {
    fn answers(&self, address: u8) -> bool {
        address == self.address
    }
    fn write(&mut self, _: u8, bytes: &[u8]) {
        Self::write(self, bytes);
    }
    fn read(&mut self, _: u8, out: &mut [u8]) {
        Self::read(self, out);
    }
    fn advance(&mut self, dt_s: f64) {
        self.reset_s -= dt_s;
        self.convert(dt_s);
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
