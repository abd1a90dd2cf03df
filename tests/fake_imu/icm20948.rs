//! Register machine of the ICM-20948 (DS-000189 rev. 1.3): four banks, sleep, reset, the internal
//! bus master with its four cyclic slaves and the one-shot slave 4, and the AK09916 behind it.

use super::{Analog, Device, FakeAk09916, Motion, Noise, Quirks, Ticker};
use retroflex::hardware::imu::icm20948::{AK_ADDRESS, BASE_RATE_HZ, WHO_AM_I, reg, scale};

/// Bank 0: first byte of temperature.
const TEMP_OUT_H: u8 = 0x39;
/// Bank 0: first byte fetched from the magnetometer.
const EXT_SLV_SENS_DATA_00: u8 = 0x3B;
/// Bank 3: rate of the internal master while the gyroscope is off.
const I2C_MST_ODR_CONFIG: u8 = 0x00;
const RESET_TIME_S: f64 = 0.5e-3;
const EXT_BYTES: usize = 24;
const SLV4_DONE: u8 = 0x40;
const SLV4_NACK: u8 = 0x10;

/// The whole package.
#[derive(Debug)]
pub struct FakeIcm20948 {
    address: u8,
    regs: [[u8; 128]; 4],
    bank: u8,
    pointer: u8,
    gyro: Ticker,
    acc: Ticker,
    master: Ticker,
    reset_s: f64,
    mag: FakeAk09916,
    analog: Analog,
}

impl FakeIcm20948 {
    /// A chip fresh from power-up at 0x68 or 0x69; the seed is that of its noise.
    #[must_use]
    pub fn new(address: u8, seed: u64) -> Self {
        let mut fake = Self {
            address,
            regs: [[0; 128]; 4],
            bank: 0,
            pointer: 0,
            gyro: Ticker::default(),
            acc: Ticker::default(),
            master: Ticker::default(),
            reset_s: 0.0,
            mag: FakeAk09916::default(),
            analog: Analog::new(seed),
        };
        fake.brown_out();
        fake
    }

    /// Power-on values of the inertial die; a register reset does not affect the magnetometer die.
    fn defaults(&mut self) {
        self.regs = [[0; 128]; 4];
        self.bank = 0;
        let zero = &mut self.regs[0];
        zero[usize::from(reg::WHO_AM_I)] = WHO_AM_I;
        zero[usize::from(reg::LP_CONFIG)] = 0x40;
        zero[usize::from(reg::PWR_MGMT_1)] = 0x41;
        self.regs[2][usize::from(reg::GYRO_CONFIG_1)] = 0x01;
        self.regs[2][usize::from(reg::ACCEL_CONFIG)] = 0x01;
        (self.gyro, self.acc, self.master) = Default::default();
    }

    fn get(&self, bank: usize, register: u8) -> u8 {
        self.regs[bank][usize::from(register)]
    }
    fn awake(&self) -> bool {
        self.get(0, reg::PWR_MGMT_1) & 0x40 == 0 && self.reset_s <= 0.0
    }
    fn gyro_on(&self) -> bool {
        self.get(0, reg::PWR_MGMT_2) & 0x07 == 0
    }
    fn acc_on(&self) -> bool {
        self.get(0, reg::PWR_MGMT_2) & 0x38 == 0
    }

    fn convert(&mut self, dt_s: f64) {
        let (g, a) = (
            self.get(2, reg::GYRO_CONFIG_1),
            self.get(2, reg::ACCEL_CONFIG),
        );
        let gyro_period = (1.0 + f64::from(self.get(2, reg::GYRO_SMPLRT_DIV))) / BASE_RATE_HZ;
        let divider = u16::from_be_bytes([
            self.get(2, reg::ACCEL_SMPLRT_DIV_1) & 0x0F,
            self.get(2, reg::ACCEL_SMPLRT_DIV_2),
        ]);
        let acc_period = (1.0 + f64::from(divider)) / BASE_RATE_HZ;
        let gyro_due = self.gyro_on() && self.gyro.due(dt_s, gyro_period);
        let acc_due = self.acc_on() && self.acc.due(dt_s, acc_period);
        if (gyro_due || acc_due) && !self.analog.quirks.frozen {
            let unit = scale(g >> 1 & 3, a >> 1 & 3);
            let (gyro, acc) = self.analog.inertial(unit.gyro_rad_s, unit.acc_m_s2);
            let temp =
                ((self.analog.motion.temp_c - unit.temp_zero_c) / unit.temp_c).round() as i16;
            if acc_due {
                self.put(reg::ACCEL_XOUT_H, &acc);
            }
            if gyro_due {
                self.put(reg::ACCEL_XOUT_H + 6, &gyro);
            }
            self.put(TEMP_OUT_H, &[temp]);
        }
        if self.master.due(dt_s, self.master_period(gyro_period))
            && self.get(0, reg::USER_CTRL) & 0x20 != 0
        {
            self.one_shot();
            self.fetch();
        }
    }

    /// The internal master works after each gyroscope conversion, or at its own rate when the
    /// gyroscope is off or the master is duty-cycled.
    fn master_period(&self, gyro_period_s: f64) -> f64 {
        let cycled = self.get(0, reg::LP_CONFIG) & 0x40 != 0;
        if self.gyro_on() && !cycled {
            gyro_period_s
        } else {
            f64::from(1_u16 << (self.get(3, I2C_MST_ODR_CONFIG) & 0x0F)) / 1100.0
        }
    }

    fn put(&mut self, from: u8, counts: &[i16]) {
        for (i, c) in counts.iter().enumerate() {
            self.regs[0][usize::from(from) + 2 * i..][..2].copy_from_slice(&c.to_be_bytes());
        }
    }

    fn mag_answers(&self, address: u8) -> bool {
        address & 0x7F == AK_ADDRESS && !self.analog.quirks.mag_dead
    }

    /// Slave 4: transfers one byte once and sets its status bits.
    fn one_shot(&mut self) {
        if self.get(3, reg::I2C_SLV4_CTRL) & 0x80 == 0 {
            return;
        }
        let (address, register) = (
            self.get(3, reg::I2C_SLV4_ADDR),
            self.get(3, reg::I2C_SLV4_REG),
        );
        let mut status = SLV4_DONE;
        if !self.mag_answers(address) {
            status |= SLV4_NACK;
        } else if address & 0x80 != 0 {
            let mut byte = [0];
            self.mag.write(&[register]);
            self.mag.read(&mut byte);
            self.regs[3][usize::from(reg::I2C_SLV4_DI)] = byte[0];
        } else {
            self.mag.write(&[register, self.get(3, reg::I2C_SLV4_DO)]);
        }
        self.regs[3][usize::from(reg::I2C_SLV4_CTRL)] &= 0x7F;
        self.regs[0][usize::from(reg::I2C_MST_STATUS)] |= status;
    }

    /// Slaves 0 to 3: fetch their blocks into EXT_SLV_SENS_DATA in every cycle.
    fn fetch(&mut self) {
        let mut at = 0;
        for slave in 0..4_u8 {
            let base = reg::I2C_SLV0_ADDR + 4 * slave;
            let (address, register) = (self.get(3, base), self.get(3, base + 1));
            let control = self.get(3, base + 2);
            let n = usize::from(control & 0x0F).min(EXT_BYTES - at);
            if control & 0x80 == 0 {
                continue;
            }
            if !self.mag_answers(address) {
                self.regs[0][usize::from(reg::I2C_MST_STATUS)] |= 1 << slave;
            } else if address & 0x80 == 0 {
                self.mag.write(&[register, self.get(3, base + 3)]);
                continue;
            } else {
                let mut block = [0; EXT_BYTES];
                self.mag.write(&[register]);
                self.mag.read(&mut block[..n]);
                let from = usize::from(EXT_SLV_SENS_DATA_00) + at;
                self.regs[0][from..from + n].copy_from_slice(&block[..n]);
            }
            at += n;
        }
    }

    /// A write as the chip sees it: register, then data with automatic increment.
    pub fn write(&mut self, bytes: &[u8]) {
        let Some((&register, data)) = bytes.split_first() else {
            return;
        };
        self.pointer = register & 0x7F;
        for &value in data {
            self.store(self.pointer, value);
            self.pointer = self.pointer.wrapping_add(1) & 0x7F;
        }
    }

    fn store(&mut self, register: u8, value: u8) {
        let data = reg::ACCEL_XOUT_H..EXT_SLV_SENS_DATA_00 + EXT_BYTES as u8;
        match (self.bank, register) {
            (_, reg::BANK_SEL) => self.bank = value >> 4 & 3,
            (0, reg::PWR_MGMT_1) if value & 0x80 != 0 => {
                self.defaults();
                self.reset_s = RESET_TIME_S;
            }
            (0, reg::USER_CTRL) => {
                if value & 0x02 != 0 {
                    self.regs[3][usize::from(reg::I2C_SLV4_CTRL)] &= 0x7F; // master reset drops what was pending
                }
                self.regs[0][usize::from(reg::USER_CTRL)] = value & 0xF0;
            }
            (0, reg::WHO_AM_I | reg::I2C_MST_STATUS) => {}
            (0, r) if data.contains(&r) => {} // read-only
            (bank, r) => {
                self.regs[usize::from(bank)][usize::from(r)] = value;
                let rate = [
                    reg::GYRO_SMPLRT_DIV,
                    reg::ACCEL_SMPLRT_DIV_1,
                    reg::ACCEL_SMPLRT_DIV_2,
                ]
                .contains(&r);
                if bank == 2 && rate && self.get(2, reg::ODR_ALIGN_EN) & 0x01 != 0 {
                    // a write to a rate register aligns the conversions of both sensors
                    (self.gyro, self.acc) = Default::default();
                }
            }
        }
    }

    /// A read from the present register on.
    pub fn read(&mut self, out: &mut [u8]) {
        for byte in out {
            *byte = self.load(self.pointer);
            self.pointer = self.pointer.wrapping_add(1) & 0x7F;
        }
    }

    fn load(&mut self, register: u8) -> u8 {
        match (self.bank, register) {
            (_, reg::BANK_SEL) => self.bank << 4,
            (0, reg::WHO_AM_I) => self.analog.quirks.wrong_id.unwrap_or(WHO_AM_I),
            (0, reg::PWR_MGMT_1) if self.reset_s > 0.0 => 0xC1,
            (0, reg::I2C_MST_STATUS) => {
                std::mem::take(&mut self.regs[0][usize::from(reg::I2C_MST_STATUS)]) // reading clears
            }
            (bank, r) => self.regs[usize::from(bank)][usize::from(r)],
        }
    }
}

impl Device for FakeIcm20948 {
    fn answers(&self, address: u8) -> bool {
        let bypass =
            self.get(0, reg::INT_PIN_CFG) & 0x02 != 0 && self.get(0, reg::USER_CTRL) & 0x20 == 0;
        address == self.address || (bypass && self.mag_answers(address))
    }
    fn write(&mut self, address: u8, bytes: &[u8]) {
        if address == self.address {
            Self::write(self, bytes)
        } else {
            self.mag.write(bytes)
        }
    }
    fn read(&mut self, address: u8, out: &mut [u8]) {
        if address == self.address {
            Self::read(self, out)
        } else {
            self.mag.read(out)
        }
    }
    fn advance(&mut self, dt_s: f64) {
        let mut left_s = dt_s;
        while left_s > 0.0 {
            let step_s = left_s.min(0.4 / BASE_RATE_HZ); // fine enough for every conversion
            left_s -= step_s;
            self.reset_s -= step_s;
            self.mag.advance(step_s, &mut self.analog);
            if self.awake() {
                self.convert(step_s);
            }
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
        self.mag.reset();
        self.pointer = 0;
    }
    fn quirks(&mut self) -> &mut Quirks {
        &mut self.analog.quirks
    }
}
