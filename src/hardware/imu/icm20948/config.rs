//! Settings of the ICM-20948 in people's units, and their translation into its registers.

use crate::hardware::imu::{Axes, STANDARD_GRAVITY_M_S2, Scale};
use crate::parameters;
use crate::primitives::{Invalid, Parameters};

/// Base conversion rate of both inertial sensors with enabled filters, Hz.
pub const BASE_RATE_HZ: f64 = 1125.0;

/// Gyroscope filters: 3 dB bandwidth by GYRO_DLPFCFG 0 to 7 (DS-000189, table of GYRO_CONFIG_1).
const GYRO_BANDWIDTH_HZ: [f64; 8] = [196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4];
/// Accelerometer filters by ACCEL_DLPFCFG 0 to 7 (table of ACCEL_CONFIG); 0 equals 1.
const ACC_BANDWIDTH_HZ: [f64; 8] = [246.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7, 473.0];

parameters! {
    /// Settings of an ICM-20948.
    pub struct IcmConfig {
        /// 7-bit bus address: 104 (0x68) with the AD0 pin low, 105 (0x69) with it high. A second sensor on the same bus takes
        /// the other one.
        address: u8 = 104, "", [104, 105], "104 (0x68) or 105 (0x69)";
        /// Full scale of the gyroscope; the default is four times the fastest bend. A larger range survives jerks and costs
        /// resolution (500 is 0.015 °/s a count).
        gyro_range_dps: u16 = 500, "°/s", [250, 500, 1000, 2000], "500 is four times the fastest bend";
        /// Full scale of the accelerometer. A larger range survives knocks and costs resolution (4 g is 0.12 mg a count).
        acc_range_g: u8 = 4, "g", [2, 4, 8, 16], "4 survives the motion of the tip";
        /// Least number of conversions per second. The chip converts at the next rate of 1125 / (1 + n) Hz that is not slower,
        /// and every conversion is read. A larger value loads the bus, which carries about 1600 readings at 400 kHz.
        rate_hz: f64 = 500.0, "Hz", 4.4..=1125.0, "500 is one conversion per turn of the loop";
        /// Smallest bandwidth of the gyroscope filter: the chip takes the next wider of 5.7, 11.6, 23.9, 51.2, 119.5, 151.8,
        /// 196.6 and 361.4. A larger value passes more noise with less delay.
        gyro_bandwidth_hz: f64 = 100.0, "Hz", 0.0..=361.4, "100 passes the fastest bend";
        /// Smallest bandwidth of the accelerometer filter: the next wider of 5.7, 11.5, 23.9, 50.4, 111.4, 246 and 473. A larger
        /// value passes more noise with less delay.
        acc_bandwidth_hz: f64 = 50.0, "Hz", 0.0..=473.0, "50 passes the fastest bend";
        /// Measurements per second of the magnetometer. A larger value averages the heading over more measurements.
        mag_rate_hz: u16 = 100, "Hz", [10, 20, 50, 100], "100";
        /// Readings between two checks that the chip still has its settings; 0 disables them. A smaller value detects a restart
        /// sooner and costs bus time: a check takes up to 0.5 ms.
        canary_every: u16 = 50, "", 0..=65_535, "50 is ten times a second at 500 Hz";
    }
}

/// A configuration in the chip's own terms, compiled once by [`IcmConfig::settings`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    pub(super) divider: u8,
    pub(super) gyro_config: u8,
    pub(super) acc_config: u8,
    pub(super) mag_mode: u8,
    pub(super) canary_every: u16,
    pub(super) scale: Scale,
}

/// Position of the narrowest filter that is at least `wanted_hz` wide, which must not exceed the widest.
fn filter(table: &[f64; 8], wanted_hz: f64) -> u8 {
    let wide = (0..8_u8).zip(table).filter(|(_, hz)| **hz >= wanted_hz);
    // of two that are alike the last
    let narrowest = wide.min_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)));
    narrowest.map_or(7, |(place, _)| place)
}

impl IcmConfig {
    /// Checks the settings and translates them.
    ///
    /// # Errors
    /// The first setting that the part does not have.
    pub fn settings(&self) -> Result<Settings, Invalid> {
        self.checked("imu.chip")?;
        // every value is in its list: the search finds it
        let code = |list: &[u16], have: u16| {
            let place = list.iter().position(|x| *x == have);
            place.unwrap_or(0) as u8
        };
        let gyro_fs = code(&[250, 500, 1000, 2000], self.gyro_range_dps);
        let acc_fs = code(&[2, 4, 8, 16], u16::from(self.acc_range_g));
        let mag_mode = code(&[10, 20, 50, 100], self.mag_rate_hz);
        let gyro_dlpf = filter(&GYRO_BANDWIDTH_HZ, self.gyro_bandwidth_hz);
        let acc_dlpf = filter(&ACC_BANDWIDTH_HZ, self.acc_bandwidth_hz);
        Ok(Settings {
            divider: ((BASE_RATE_HZ / self.rate_hz).floor() - 1.0) as u8,
            gyro_config: gyro_dlpf << 3 | gyro_fs << 1 | 1,
            acc_config: acc_dlpf << 3 | acc_fs << 1 | 1,
            mag_mode: (mag_mode + 1) << 1,
            canary_every: self.canary_every,
            scale: scale(gyro_fs, acc_fs),
        })
    }
}

/// SI value of a count for FS_SEL fields. The sheet lists 131, 65.5, 32.8 and 16.4 LSB/(°/s) and
/// 16384 … 2048 LSB/g (tables 1 and 2); temperature is 333.87 LSB/°C around 21 °C, the field
/// 0.15 µT/LSB (table 3, p. 13).
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_the_register_fields() {
        let s = IcmConfig::default().settings().expect("default");
        assert_eq!(s.divider, 1, "562.5 Hz is the next rate above 500");
        assert_eq!(s.gyro_config, 2 << 3 | 1 << 1 | 1, "119.5 Hz, 500 dps");
        assert_eq!(s.acc_config, 3 << 3 | 1 << 1 | 1, "50.4 Hz, 4 g");
        assert_eq!(s.mag_mode, 0x08, "continuous mode 4");
        let fast = IcmConfig {
            rate_hz: 1125.0,
            gyro_bandwidth_hz: 300.0,
            ..IcmConfig::default()
        };
        let s = fast.settings().expect("fast");
        assert_eq!((s.divider, s.gyro_config >> 3), (0, 7));
    }

    #[test]
    fn settings_name_what_is_wrong() {
        let bad = [
            (
                IcmConfig {
                    address: 0x42,
                    ..IcmConfig::default()
                },
                "address",
            ),
            (
                IcmConfig {
                    gyro_range_dps: 300,
                    ..IcmConfig::default()
                },
                "gyro_range_dps",
            ),
            (
                IcmConfig {
                    acc_range_g: 3,
                    ..IcmConfig::default()
                },
                "acc_range_g",
            ),
            (
                IcmConfig {
                    rate_hz: 2000.0,
                    ..IcmConfig::default()
                },
                "rate_hz",
            ),
            (
                IcmConfig {
                    rate_hz: f64::NAN,
                    ..IcmConfig::default()
                },
                "rate_hz",
            ),
            (
                IcmConfig {
                    gyro_bandwidth_hz: 400.0,
                    ..IcmConfig::default()
                },
                "gyro_bandwidth_hz",
            ),
            (
                IcmConfig {
                    acc_bandwidth_hz: f64::NAN,
                    ..IcmConfig::default()
                },
                "acc_bandwidth_hz",
            ),
            (
                IcmConfig {
                    mag_rate_hz: 75,
                    ..IcmConfig::default()
                },
                "mag_rate_hz",
            ),
        ];
        for (config, field) in bad {
            let error = config.settings().expect_err(field);
            assert_eq!(error.key, format!("imu.chip.{field}"));
        }
    }

    #[test]
    fn every_rate_is_met_or_exceeded_by_the_slowest_that_does() {
        for rate_hz in [4.4, 10.0, 100.0, 225.0, 226.0, 499.0, 562.5, 563.0, 1125.0] {
            let s = IcmConfig {
                rate_hz,
                ..IcmConfig::default()
            }
            .settings()
            .expect("in range");
            let odr = |n: u8| BASE_RATE_HZ / (1.0 + f64::from(n));
            assert!(odr(s.divider) >= rate_hz - 1e-9, "{rate_hz}");
            assert!(
                s.divider == 255 || odr(s.divider + 1) < rate_hz,
                "{rate_hz}"
            );
        }
    }
}
