//! Settings of an LSM6DSO or LSM6DSV16X and its LIS2MDL in people's units, and their translation into the registers of each.

use super::reg;
use crate::hardware::imu::{Axes, Part, STANDARD_GRAVITY_M_S2, Scale, lis2mdl};
use crate::parameters;
use crate::primitives::{Invalid, Parameters};

/// Conversion rates of the LSM6DSO by ODR code 1 to 10, Hz (p. 10).
pub const RATES_HZ: [f64; 10] = [
    12.5, 26.0, 52.0, 104.0, 208.0, 416.0, 833.0, 1666.0, 3332.0, 6664.0,
];
/// The same of the LSM6DSV16X, code 1 to 12.
const DSV_RATES_HZ: [f64; 12] = [
    1.875, 7.5, 15.0, 30.0, 60.0, 120.0, 240.0, 480.0, 960.0, 1920.0, 3840.0, 7680.0,
];

/// The parts that this driver serves. Their data are in the same places, their settings are not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// LSM6DSO (ST DS12140).
    Dso,
    /// LSM6DSV16X (ST DS13510).
    Dsv16x,
}

impl Variant {
    /// The part, the content of its WHO_AM_I, and its conversion rates by ODR code from 1 on, Hz.
    pub fn part(self) -> (Part, u8, &'static [f64]) {
        match self {
            Self::Dso => (Part::Lsm6dso, 0x6C, &RATES_HZ),
            Self::Dsv16x => (Part::Lsm6dsv16x, 0x70, &DSV_RATES_HZ),
        }
    }
}

parameters! {
    /// Settings of an LSM6DSO or LSM6DSV16X and the LIS2MDL beside it.
    pub struct LsmConfig {
        /// 7-bit bus address of the six-axis chip: 106 (0x6A) with SA0 low, 107 (0x6B) with it high. The LIS2MDL is always at 30
        /// (0x1E).
        address: u8 = 106, "", [106, 107], "106 (0x6A) or 107 (0x6B)";
        /// Full scale of the gyroscope. A larger range survives jerks and costs resolution (500 is 0.0175 °/s a count).
        gyro_range_dps: u16 = 500, "°/s", [125, 250, 500, 1000, 2000], "500 is four times the fastest bend";
        /// Full scale of the accelerometer. A larger range survives knocks and costs resolution (4 g is 0.122 mg a count).
        acc_range_g: u8 = 4, "g", [2, 4, 8, 16], "4 survives the motion of the tip";
        /// Least number of conversions per second. The chip converts at the next rate that is not slower, of 12.5, 26, 52, 104, 208,
        /// 416, 833 … Hz (LSM6DSO) or 7.5, 15, 30, 60, 120, 240, 480, 960 … Hz (LSM6DSV16X), and every conversion is read as far as
        /// the bus permits. A larger value loads the bus.
        rate_hz: f64 = 500.0, "Hz", 1.0..=6664.0, "500 is one conversion per turn of the loop";
        /// Gyroscope low-pass, code of the first stage's width; left out, only the fixed second stage (295 Hz at 833 Hz). 3 is the widest, a
        /// larger value is narrower.
        gyro_filter: Option<u8> = None, "", 0..=7, "leave it out for the fixed second stage alone";
        /// Accelerometer low-pass as a divisor of the conversion rate; 10 is 83 Hz at 833 Hz. A larger value filters more and
        /// delays more.
        acc_filter_divisor: u16 = 2, "", [2, 4, 10, 20, 45, 100, 200, 400, 800], "10 is 83 Hz at 833 Hz";
        /// Measurements per second of the LIS2MDL. A larger value averages the heading over more measurements.
        mag_rate_hz: u16 = 100, "Hz", [10, 20, 50, 100], "100";
        /// Orientation of the LIS2MDL against the LSM6DSO: x, y and z of the LSM6DSO as signed axes of the LIS2MDL. The default
        /// is side by side with the same pin-1 corner.
        mag_axes: Axes = Axes::ALIGNED;
        /// Readings between two checks that the chips still have their settings; 0 disables them. A smaller value detects a
        /// restart sooner and costs bus time (0.25 ms a check).
        canary_every: u16 = 50, "", 0..=65_535, "50 is ten times a second at 500 Hz";
    }
}

/// Registers with their values.
pub type Writes = [(u8, u8); 7];

/// A configuration in the chips' own terms.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Registers with the values that are written after a reset, in this order.
    pub(super) writes: Writes,
    /// Values and masks from CTRL1 on by which a chip that has restarted is recognised.
    pub(super) canary: Vec<(u8, u8)>,
    pub(super) rate_hz: f64,
    pub(super) mag_every: u16,
    pub(super) canary_every: u16,
    pub(super) scale: Scale,
}

/// Ranges of the gyroscope, °/s. Their place is FS_G of the LSM6DSV16X (CTRL6).
const GYRO_DPS: [u16; 5] = [125, 250, 500, 1000, 2000];
/// FS_G and FS_125 bits of the LSM6DSO (CTRL2_G) for each of them.
const DSO_FS_G: [u8; 5] = [0b0010, 0b0000, 0b0100, 0b1000, 0b1100];
/// Ranges of the accelerometer, g. Their place is FS_XL of the LSM6DSV16X (CTRL8).
const ACC_G: [u8; 4] = [2, 4, 8, 16];
/// FS_XL bits of the LSM6DSO (CTRL1_XL) for each of them; note that 16 g sits at code 1.
const DSO_FS_XL: [u8; 4] = [0b0000, 0b1000, 0b1100, 0b0100];
/// Accelerometer filter: divisor of the rate by HPCF_XL (CTRL8_XL); 2 is the first stage alone.
const ACC_DIVISORS: [u16; 8] = [4, 10, 20, 45, 100, 200, 400, 800];

const CTRL3: u8 = 0x44; // BDU, IF_INC
const DSO_CTRL9: u8 = 0xE2; // default, I3C disabled

/// SI value of a count for a range, on either part: 35 mdps per 1000 °/s, 0.122 mg per 4 g (mechanical characteristics); 256 LSB/°C at 25 °C.
pub fn scale(gyro_range_dps: u16, acc_range_g: u8, mag_axes: Axes) -> Scale {
    Scale {
        gyro_rad_s: (f64::from(gyro_range_dps) * 35e-6).to_radians(),
        acc_m_s2: f64::from(acc_range_g) * 0.0305e-3 * STANDARD_GRAVITY_M_S2,
        mag_ut: lis2mdl::UT_PER_LSB,
        mag_axes,
        temp_c: 1.0 / 256.0,
        temp_zero_c: 25.0,
    }
}

impl LsmConfig {
    /// Checks the settings and translates them.
    ///
    /// # Errors
    /// The first setting that the parts do not have.
    pub fn settings(&self, variant: Variant) -> Result<Settings, Invalid> {
        self.checked("imu.chip")?;
        if !self.mag_axes.is_permutation() {
            return Err(Invalid {
                key: "imu.chip.mag_axes".to_owned(),
                problem: "an axis is used twice".to_owned(),
                hint: "each of x, y and z once, with a sign".to_owned(),
            });
        }
        // every value is in its list: the searches find it
        let (_, _, rates_hz) = variant.part();
        let mut rates = (1_u8..).zip(rates_hz.iter().copied());
        let enough = rates.find(|(_, rate)| *rate >= self.rate_hz);
        let (odr, rate_hz) = enough.unwrap_or((1, rates_hz[0]));
        let (writes, canary) = self.registers(variant, odr);
        Ok(Settings {
            writes,
            canary,
            rate_hz,
            // a quarter faster than the magnetometer, so that none of its values is missed
            mag_every: (self.rate_hz / (1.25 * f64::from(self.mag_rate_hz))).max(1.0) as u16,
            canary_every: self.canary_every,
            scale: scale(self.gyro_range_dps, self.acc_range_g, self.mag_axes),
        })
    }

    /// What is written after a reset, and what a chip that has restarted is recognised by, from CTRL1 on.
    fn registers(&self, variant: Variant, odr: u8) -> (Writes, Vec<(u8, u8)>) {
        let gyro = GYRO_DPS.iter().position(|dps| *dps == self.gyro_range_dps);
        let acc = ACC_G.iter().position(|g| *g == self.acc_range_g);
        let (gyro, acc) = (gyro.unwrap_or(0), acc.unwrap_or(0));
        let mut divisors = ACC_DIVISORS.iter();
        let divisor = divisors.position(|d| *d == self.acc_filter_divisor);
        let (acc_bw, acc_on) = divisor.map_or((0, 0), |d| ((d as u8) << 5, 1));
        let (gyro_bw, gyro_on) = self.gyro_filter.map_or((0, 0), |code| (code, 1));
        match variant {
            Variant::Dso => {
                let ctrl1 = odr << 4 | DSO_FS_XL[acc] | acc_on << 1;
                let (ctrl2, ctrl4) = (odr << 4 | DSO_FS_G[gyro], gyro_on << 1);
                let writes = [
                    (reg::CTRL3, CTRL3),
                    (reg::CTRL9, DSO_CTRL9),
                    (reg::CTRL4, ctrl4),
                    (reg::CTRL6, gyro_bw),
                    (reg::CTRL8, acc_bw),
                    (reg::CTRL1, ctrl1),
                    (reg::CTRL2, ctrl2),
                ];
                let canary = vec![(ctrl1, 0xFE), (ctrl2, 0xFE), (CTRL3, 0xC5), (ctrl4, 0x42)];
                (writes, canary)
            }
            Variant::Dsv16x => {
                let (ctrl6, ctrl8) = (gyro_bw << 4 | gyro as u8, acc_bw | acc as u8);
                let writes = [
                    (reg::CTRL3, CTRL3),
                    (reg::CTRL6, ctrl6),
                    (reg::CTRL7, gyro_on),
                    (reg::CTRL8, ctrl8),
                    (reg::CTRL9, acc_on << 3),
                    (reg::CTRL1, odr),
                    (reg::CTRL2, odr),
                ];
                // CTRL4 and CTRL5 keep their defaults, which nobody depends on
                let mut canary = vec![(odr, 0x7F), (odr, 0x7F), (CTRL3, 0xC5), (0, 0), (0, 0)];
                canary.extend([(ctrl6, 0x7F), (gyro_on, 0x01), (ctrl8, 0xEB)]);
                (writes, canary)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_the_register_fields() {
        let of = |config: &LsmConfig, variant| {
            let s = config.settings(variant).expect("valid");
            let value = |register| s.writes.into_iter().find(|w| w.0 == register).unwrap().1;
            (
                [reg::CTRL1, reg::CTRL2, reg::CTRL6, reg::CTRL8].map(value),
                s.mag_every,
            )
        };
        let (dso, dsv) = (Variant::Dso, Variant::Dsv16x);
        // 833 Hz; 4 g is code 2, 500 dps code 1
        assert_eq!(of(&LsmConfig::default(), dso), ([0x78, 0x74, 0, 0], 4));
        // 960 Hz; 4 g and 500 dps are in registers of their own
        assert_eq!(
            of(&LsmConfig::default(), dsv),
            ([0x09, 0x09, 0x02, 0x01], 4)
        );
        let filtered = LsmConfig {
            acc_filter_divisor: 20,
            gyro_filter: Some(5),
            ..LsmConfig::default()
        };
        assert_eq!(of(&filtered, dso).0, [0x7A, 0x74, 5, 0x40]);
        assert_eq!(of(&filtered, dsv).0, [0x09, 0x09, 0x52, 0x41]);
        let enabled = |variant, register| {
            let s = filtered.settings(variant).unwrap();
            s.writes.into_iter().find(|w| w.0 == register).unwrap().1
        };
        assert_eq!(enabled(dso, reg::CTRL4), 0x02);
        assert_eq!((enabled(dsv, reg::CTRL7), enabled(dsv, reg::CTRL9)), (1, 8));
        let wide = LsmConfig {
            acc_range_g: 16,
            gyro_range_dps: 125,
            ..LsmConfig::default()
        };
        assert_eq!(of(&wide, dso).0, [0x74, 0x72, 0, 0]);
        assert_eq!(of(&wide, dsv).0, [0x09, 0x09, 0, 3]);
    }

    #[test]
    fn scales_are_the_data_sheets_sensitivities() {
        for (dps, mdps) in [
            (125, 4.375),
            (250, 8.75),
            (500, 17.5),
            (1000, 35.0),
            (2000, 70.0),
        ] {
            let have = scale(dps, 2, Axes::ALIGNED).gyro_rad_s.to_degrees() * 1e3;
            assert!((have - mdps).abs() < 1e-9, "{dps}: {have}");
        }
        for (g, mg) in [(2, 0.061), (4, 0.122), (8, 0.244), (16, 0.488)] {
            let have = scale(500, g, Axes::ALIGNED).acc_m_s2 / STANDARD_GRAVITY_M_S2 * 1e3;
            assert!((have - mg).abs() < 1e-9, "{g}: {have}");
        }
    }

    #[test]
    fn settings_name_what_is_wrong() {
        let bad = [
            (
                LsmConfig {
                    address: 0x68,
                    ..LsmConfig::default()
                },
                "address",
            ),
            (
                LsmConfig {
                    gyro_range_dps: 245,
                    ..LsmConfig::default()
                },
                "gyro_range_dps",
            ),
            (
                LsmConfig {
                    acc_range_g: 6,
                    ..LsmConfig::default()
                },
                "acc_range_g",
            ),
            (
                LsmConfig {
                    rate_hz: 7000.0,
                    ..LsmConfig::default()
                },
                "rate_hz",
            ),
            (
                LsmConfig {
                    rate_hz: 0.0,
                    ..LsmConfig::default()
                },
                "rate_hz",
            ),
            (
                LsmConfig {
                    gyro_filter: Some(8),
                    ..LsmConfig::default()
                },
                "gyro_filter",
            ),
            (
                LsmConfig {
                    acc_filter_divisor: 3,
                    ..LsmConfig::default()
                },
                "acc_filter_divisor",
            ),
        ];
        for (config, field) in bad {
            assert_eq!(
                config.settings(Variant::Dso).expect_err(field).key,
                format!("imu.chip.{field}")
            );
        }
        let text =
            "part = \"lsm6dso_lis2mdl\"\nmag_axes = [\"-y\", \"+x\", \"+z\"]\nacc_range_g = 8\n";
        let config: crate::hardware::imu::ChipConfig = toml::from_str(text).expect("valid");
        let crate::hardware::imu::ChipConfig::Lsm6dsoLis2mdl(config) = config else {
            panic!("wrong part")
        };
        assert_eq!(config.acc_range_g, 8);
        let twice = LsmConfig {
            mag_axes: Axes([crate::hardware::imu::Axis::PlusX; 3]),
            ..LsmConfig::default()
        };
        assert_eq!(
            twice.settings(Variant::Dsv16x).expect_err("twice x").key,
            "imu.chip.mag_axes"
        );
        assert!(
            toml::from_str::<crate::hardware::imu::ChipConfig>(
                "part = \"icm20948\"\nacc_rang_g = 8\n"
            )
            .is_err()
        );
        assert!(
            toml::from_str::<crate::hardware::imu::ChipConfig>("part = \"mpu6050\"\n").is_err()
        );
    }
}
