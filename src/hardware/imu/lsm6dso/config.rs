//! Settings of the LSM6DSO and its LIS2MDL in people's units, and their translation into registers.

use crate::hardware::imu::{Axes, STANDARD_GRAVITY_M_S2, Scale, lis2mdl};
use crate::parameters;
use crate::primitives::{Checker, Invalid, Parameters};

/// Conversion rates by ODR code 1 to 10, Hz (p. 10).
pub const RATES_HZ: [f64; 10] = [
    12.5, 26.0, 52.0, 104.0, 208.0, 416.0, 833.0, 1666.0, 3332.0, 6664.0,
];

parameters! {
    /// Settings of an LSM6DSO and the LIS2MDL beside it.
    pub struct LsmConfig {
        /// 7-bit bus address of the LSM6DSO: 106 (0x6A) with SA0 low, 107 (0x6B) with it high. The LIS2MDL is always at 30
        /// (0x1E).
        address: u8 = 106, "", [106, 107], "106 (0x6A) or 107 (0x6B)";
        /// Full scale of the gyroscope. A larger range survives jerks and costs resolution (500 is 0.0175 °/s a count).
        gyro_range_dps: u16 = 500, "°/s", [125, 250, 500, 1000, 2000], "500 is four times the fastest bend";
        /// Full scale of the accelerometer. A larger range survives knocks and costs resolution (4 g is 0.122 mg a count).
        acc_range_g: u8 = 4, "g", [2, 4, 8, 16], "4 survives the motion of the tip";
        /// Least number of conversions per second. The chip converts at the next rate of 12.5, 26, 52, 104, 208, 416, 833, 1666 …
        /// Hz that is not slower, and every conversion is read as far as the bus permits. A larger value loads the bus.
        rate_hz: f64 = 500.0, "Hz", 1.0..=6664.0, "500 is one conversion per turn of the loop";
        /// Gyroscope low-pass, CTRL6_C.FTYPE; left out, only the fixed second stage (295 Hz at 833 Hz). 3 is the widest, a
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

/// A configuration in the chips' own terms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    pub(super) address: u8,
    pub(super) ctrl1: u8,
    pub(super) ctrl2: u8,
    pub(super) ctrl4: u8,
    pub(super) ctrl6: u8,
    pub(super) ctrl8: u8,
    pub(super) rate_hz: f64,
    pub(super) mag_every: u16,
    pub(super) canary_every: u16,
    pub(super) scale: Scale,
}

/// Gyroscope: range in °/s, FS_G and FS_125 bits (DS12140, CTRL2_G).
const GYRO: [(u16, u8); 5] = [
    (125, 0b0010),
    (250, 0b0000),
    (500, 0b0100),
    (1000, 0b1000),
    (2000, 0b1100),
];
/// Accelerometer: range in g, FS_XL bits (CTRL1_XL); note that 16 g sits at code 1.
const ACC: [(u8, u8); 4] = [(2, 0b0000), (4, 0b1000), (8, 0b1100), (16, 0b0100)];
/// Accelerometer filter: divisor of the rate by HPCF_XL (CTRL8_XL); 2 is the first stage alone.
const ACC_DIVISORS: [u16; 8] = [4, 10, 20, 45, 100, 200, 400, 800];

/// SI value of a count for a range: 35 mdps per 1000 °/s, 0.122 mg per 4 g (mechanical characteristics); 256 LSB/°C at 25 °C.
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
    pub fn settings(&self) -> Result<Settings, Invalid> {
        self.checked("imu.chip")?;
        let mut checker = Checker::default();
        checker
            .at("imu.chip.mag_axes")
            .holds(self.mag_axes.is_permutation(), "an axis is used twice")
            .hint("each of x, y and z once, with a sign");
        checker.done()?;
        // every value is in its list: the searches find it
        let fs_g = GYRO
            .into_iter()
            .find(|(range, _)| *range == self.gyro_range_dps)
            .map_or(0, |(_, bits)| bits);
        let fs_xl = ACC
            .into_iter()
            .find(|(range, _)| *range == self.acc_range_g)
            .map_or(0, |(_, bits)| bits);
        let (odr, rate_hz) = (1_u8..)
            .zip(RATES_HZ)
            .find(|(_, rate)| *rate >= self.rate_hz)
            .unwrap_or((1, RATES_HZ[0]));
        let divisor = ACC_DIVISORS
            .into_iter()
            .position(|d| d == self.acc_filter_divisor);
        Ok(Settings {
            address: self.address,
            ctrl1: odr << 4 | fs_xl | if divisor.is_some() { 0x02 } else { 0 },
            ctrl2: odr << 4 | fs_g,
            ctrl4: if self.gyro_filter.is_some() { 0x02 } else { 0 },
            ctrl6: self.gyro_filter.unwrap_or(0),
            ctrl8: divisor.map_or(0, |d| (d as u8) << 5),
            rate_hz,
            // a quarter faster than the magnetometer, so that none of its values is missed
            mag_every: (self.rate_hz / (1.25 * f64::from(self.mag_rate_hz)))
                .floor()
                .max(1.0) as u16,
            canary_every: self.canary_every,
            scale: scale(self.gyro_range_dps, self.acc_range_g, self.mag_axes),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_the_register_fields() {
        let s = LsmConfig::default().settings().expect("default");
        assert_eq!(
            (s.ctrl1, s.ctrl2),
            (0x78, 0x74),
            "833 Hz; 4 g is code 2, 500 dps code 1"
        );
        assert_eq!((s.ctrl4, s.ctrl6, s.ctrl8, s.mag_every), (0, 0, 0, 4));
        let filtered = LsmConfig {
            acc_filter_divisor: 20,
            gyro_filter: Some(5),
            ..LsmConfig::default()
        };
        let s = filtered.settings().expect("filtered");
        assert_eq!((s.ctrl1, s.ctrl4, s.ctrl6, s.ctrl8), (0x7A, 0x02, 5, 0x40));
        let wide = LsmConfig {
            acc_range_g: 16,
            gyro_range_dps: 125,
            ..LsmConfig::default()
        };
        let s = wide.settings().expect("wide");
        assert_eq!((s.ctrl1, s.ctrl2), (0x74, 0x72));
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
                config.settings().expect_err(field).key,
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
            twice.settings().expect_err("twice x").key,
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
