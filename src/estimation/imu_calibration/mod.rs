//! Calibration of the IMU: biases and matrices from recorded motion, each with its standard deviation. An insufficient
//! recording is refused with the motion that is missing.
//!
//! | function | requires | determines |
//! |---|---|---|
//! | [`gyro::at_rest`] | a rest | gyroscope bias |
//! | [`accel::six_positions`] | a rest on each face | accelerometer bias, scale |
//! | [`accel::ellipsoid`] | rests in all directions | accelerometer bias, symmetric matrix |
//! | [`mag::ellipsoid`] | a slow tumble | hard and soft iron |
//! | [`motor::fit`] | motors stepped, tip still | coil fields over the microstep phase |
//! | [`mount::from_bends`] | pure bends | rotation from sensor to tip |
//!
//! The correction is `x = M (x_raw − b)` for accelerometer and magnetometer, `ω = ω_raw − b` for the gyroscope. A tumble
//! alone does not determine a rotation, so M is symmetric. The standard deviations come from the residuals.

pub mod accel;
pub mod driven;
mod ellipsoid;
mod entry;
pub mod gyro;
pub mod mag;
pub mod motor;
pub mod mount;
mod refusal;
pub mod still;

pub use ellipsoid::{SAMPLES_MIN as ELLIPSOID_SAMPLES_MIN, VectorFit};
pub use entry::{Entry, Pedigree, Rows};
pub use refusal::Refusal;

use crate::primitives::{ImuSample, Setting, Shape};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// The `[imu]` table of a calibration file. An error without an entry is not corrected.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuCalibration {
    /// Gyroscope bias, rad/s: subtracted.
    pub gyro_bias_rad_s: Option<Entry<[f64; 3]>>,
    /// Accelerometer bias, m/s²: subtracted before the matrix.
    pub acc_bias_m_s2: Option<Entry<[f64; 3]>>,
    /// Accelerometer scale and skew, rows of a matrix near 1.
    pub acc_matrix: Option<Entry<Rows>>,
    /// Hard iron, µT: subtracted before the matrix.
    pub mag_bias_ut: Option<Entry<[f64; 3]>>,
    /// Soft iron, rows of a matrix near 1 with determinant 1.
    pub mag_matrix: Option<Entry<Rows>>,
    /// Rotation vector from sensor to tip, degrees: applied to all three sensors after the other corrections.
    pub mount_deg: Option<Entry<[f64; 3]>>,
    /// Fields of the motor coils, fixed in the base frame; [`motor::MotorField`] computes them from the phases.
    pub motor_field: Option<motor::MotorField>,
}

/// Results with sigma, date and source: described with each entry.
impl Setting for ImuCalibration {
    const SHAPE: Shape = Shape::Opaque;
}

impl ImuCalibration {
    /// Stores a gyroscope bias.
    pub fn set_gyro(&mut self, fit: &gyro::GyroBias, from: Pedigree<'_>) {
        self.gyro_bias_rad_s = Some(from.entry(fit.bias_rad_s.into(), fit.sigma_rad_s.into()));
    }
    /// Stores a fit of the accelerometer, m/s².
    pub fn set_accel(&mut self, fit: &VectorFit, from: Pedigree<'_>) {
        (self.acc_bias_m_s2, self.acc_matrix) = from.entries(fit);
    }
    /// Stores a fit of the magnetometer, µT.
    pub fn set_mag(&mut self, fit: &VectorFit, from: Pedigree<'_>) {
        (self.mag_bias_ut, self.mag_matrix) = from.entries(fit);
    }
    /// Stores a mount rotation.
    pub fn set_mount(&mut self, fit: &mount::Mount, from: Pedigree<'_>) {
        let value = fit.r_tip_sensor.quat().scaled_axis().map(f64::to_degrees);
        self.mount_deg = Some(from.entry(value.into(), fit.sigma_rad.map(f64::to_degrees).into()));
    }
    /// The correction to apply to every sample.
    pub fn correction(&self) -> Correction {
        let vector = |e: &Option<Entry<[f64; 3]>>| {
            e.as_ref().map_or_else(Vector3::zeros, |e| e.value.into())
        };
        let table = |e: &Option<Entry<Rows>>| {
            e.as_ref().map_or_else(Matrix3::identity, |e| {
                Matrix3::from_fn(|i, j| e.value[i][j])
            })
        };
        let mount = UnitQuaternion::from_scaled_axis(vector(&self.mount_deg).map(f64::to_radians))
            .to_rotation_matrix()
            .into_inner();
        let affine = |bias, matrix| Affine {
            bias: vector(bias),
            matrix,
        };
        Correction {
            gyro: affine(&self.gyro_bias_rad_s, mount),
            acc: affine(&self.acc_bias_m_s2, mount * table(&self.acc_matrix)),
            mag: affine(&self.mag_bias_ut, mount * table(&self.mag_matrix)),
        }
    }
}

/// A calibration reduced to its values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Of the gyroscope, rad/s.
    pub gyro: Affine,
    /// Of the accelerometer, m/s².
    pub acc: Affine,
    /// Of the magnetometer, µT.
    pub mag: Affine,
}

/// Correction of one sensor, in its unit: `x = matrix (x_raw − bias)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    /// Subtracted first.
    pub bias: Vector3<f64>,
    /// Scale and skew or soft iron, then the mount.
    pub matrix: Matrix3<f64>,
}

impl Affine {
    fn apply(&self, raw: Vector3<f64>) -> Vector3<f64> {
        self.matrix * (raw - self.bias)
    }
}

impl Correction {
    /// The sample of an ideal sensor in the axes of the tip.
    pub fn apply(&self, raw: &ImuSample) -> ImuSample {
        ImuSample {
            t: raw.t,
            gyro_rad_s: self.gyro.apply(raw.gyro_rad_s),
            acc_m_s2: self.acc.apply(raw.acc_m_s2),
            mag_ut: raw.mag_ut.map(|m| self.mag.apply(m)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;

    #[test]
    fn a_file_reads_back_and_missing_entries_change_nothing() {
        let raw = ImuSample {
            t: Seconds(1.0),
            gyro_rad_s: Vector3::new(0.1, 0.2, 0.3),
            acc_m_s2: Vector3::new(1.0, 2.0, 9.0),
            mag_ut: Some(Vector3::new(30.0, -10.0, 5.0)),
        };
        assert_eq!(ImuCalibration::default().correction().apply(&raw), raw);
        let from = Pedigree {
            date: "2025-01-31",
            source: "tumble.csv",
        };
        let calibration = ImuCalibration {
            gyro_bias_rad_s: Some(from.entry([0.1, 0.0, -0.1], [1e-4; 3])),
            mag_bias_ut: Some(from.entry([10.0, -20.0, 0.0], [0.1; 3])),
            mag_matrix: Some(from.entry(
                [[2.0, 0.0, 0.0], [0.0, 0.5, 0.1], [0.0, 0.1, 1.0]],
                [[0.0; 3]; 3],
            )),
            ..ImuCalibration::default()
        };
        let text = toml::to_string(&calibration).expect("serialises");
        let back: ImuCalibration = toml::from_str(&text).expect("reads back");
        assert_eq!(back, calibration);
        let s = back.correction().apply(&raw);
        assert_eq!(s.gyro_rad_s, Vector3::new(0.0, 0.2, 0.4));
        assert_eq!(s.mag_ut, Some(Vector3::new(40.0, 5.5, 6.0)));
        assert_eq!(s.acc_m_s2, raw.acc_m_s2);
        assert!(toml::from_str::<ImuCalibration>("gyro_bias = [0,0,0]").is_err());
    }

    #[test]
    fn the_mount_rotates_all_three_sensors() {
        let from = Pedigree {
            date: "2025-01-31",
            source: "bends.csv",
        };
        let turned = ImuCalibration {
            mount_deg: Some(from.entry([0.0, 0.0, 90.0], [0.1; 3])),
            ..ImuCalibration::default()
        };
        let raw = ImuSample {
            t: Seconds(0.0),
            gyro_rad_s: Vector3::x(),
            acc_m_s2: Vector3::x(),
            mag_ut: Some(Vector3::x()),
        };
        let s = turned.correction().apply(&raw);
        for v in [s.gyro_rad_s, s.acc_m_s2, s.mag_ut.unwrap_or_default()] {
            assert!((v - Vector3::y()).norm() < 1e-12);
        }
    }
}
