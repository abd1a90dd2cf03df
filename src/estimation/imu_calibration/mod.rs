//! Calibration of the inertial sensor: from recorded motion to bias and matrix, each with its sigma,
//! or to a refusal that says which motion was missing.
//!
//! | function | needs | gives |
//! |---|---|---|
//! | [`gyro::at_rest`] | a rest | gyroscope bias |
//! | [`accel::six_positions`] | a rest on each face | accelerometer bias, scale |
//! | [`accel::ellipsoid`] | rests all round | accelerometer bias, symmetric matrix |
//! | [`mag::ellipsoid`] | a slow tumble | hard and soft iron |
//! | [`motor::fit`] | motors stepped, tip still | coil fields over microstep phase |
//! | [`mount::from_bends`] | pure bends | rotation sensor to tip |
//!
//! The correction is `x = M (x_raw − b)` for accelerometer and magnetometer, `ω = ω_raw − b` for the
//! gyroscope. A tumble alone cannot tell a rotation from the truth, so M is symmetric. Sigmas come
//! from the residuals and assume that neighbouring samples are independent.

pub mod accel;
mod ellipsoid;
pub mod gyro;
mod limits;
pub mod mag;
pub mod motor;
pub mod mount;
mod refusal;
pub mod still;

pub use limits::CalibrationLimits;
pub use refusal::Refusal;

use crate::primitives::parameters::{Setting, Shape};
use crate::primitives::sample::ImuSample;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A calibrated quantity with its pedigree.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry<T> {
    /// Best estimate.
    pub value: T,
    /// One standard deviation of each number of `value`.
    pub sigma: T,
    /// Day of the recording, `2025-01-31`.
    pub date: String,
    /// File or procedure it came from.
    pub source: String,
}

/// Where a calibration comes from.
#[derive(Debug, Clone, Copy)]
pub struct Pedigree<'a> {
    /// Day of the recording.
    pub date: &'a str,
    /// File or procedure.
    pub source: &'a str,
}

impl Pedigree<'_> {
    fn entry<T>(self, value: T, sigma: T) -> Entry<T> {
        Entry { value, sigma, date: self.date.to_owned(), source: self.source.to_owned() }
    }
}

/// Rows of a 3 × 3 matrix, as in files.
pub type Rows = [[f64; 3]; 3];

fn rows(m: &Matrix3<f64>) -> Rows {
    [0, 1, 2].map(|i| [m[(i, 0)], m[(i, 1)], m[(i, 2)]])
}

fn matrix(r: &Rows) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| r[i][j])
}

/// The `[imu]` table of a calibration file; what is left out is not corrected.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuCalibration {
    /// Gyroscope at rest, rad/s: subtracted.
    pub gyro_bias_rad_s: Option<Entry<[f64; 3]>>,
    /// Accelerometer zero, m/s²: subtracted before the matrix.
    pub acc_bias_m_s2: Option<Entry<[f64; 3]>>,
    /// Accelerometer scale and skew, rows of a matrix near 1.
    pub acc_matrix: Option<Entry<Rows>>,
    /// Hard iron, µT: subtracted before the matrix.
    pub mag_bias_ut: Option<Entry<[f64; 3]>>,
    /// Soft iron, rows of a matrix near 1 with determinant 1.
    pub mag_matrix: Option<Entry<Rows>>,
    /// Rotation sensor to tip as a rotation vector, degrees: turns all three vectors into the tip's axes,
    /// after everything else.
    pub mount_deg: Option<Entry<[f64; 3]>>,
    /// Fields of the motor coils, fixed in the base frame. Subtracted by [`motor::MotorField`], which
    /// must know the phases.
    pub motor_field: Option<motor::MotorField>,
}

/// Results with sigma, date and source: described with each entry.
impl Setting for ImuCalibration {
    const SHAPE: Shape = Shape::Opaque;
}

impl ImuCalibration {
    /// Takes over a gyroscope bias.
    pub fn set_gyro(&mut self, fit: &gyro::GyroBias, from: Pedigree<'_>) {
        self.gyro_bias_rad_s = Some(from.entry(fit.bias_rad_s.into(), fit.sigma_rad_s.into()));
    }
    /// Takes over an accelerometer fit.
    pub fn set_accel(&mut self, fit: &accel::AccFit, from: Pedigree<'_>) {
        self.acc_bias_m_s2 = Some(from.entry(fit.bias_m_s2.into(), fit.bias_sigma_m_s2.into()));
        self.acc_matrix = Some(from.entry(rows(&fit.matrix), rows(&fit.matrix_sigma)));
    }
    /// Takes over a magnetometer fit.
    pub fn set_mag(&mut self, fit: &mag::MagFit, from: Pedigree<'_>) {
        self.mag_bias_ut = Some(from.entry(fit.bias_ut.into(), fit.bias_sigma_ut.into()));
        self.mag_matrix = Some(from.entry(rows(&fit.matrix), rows(&fit.matrix_sigma)));
    }
    /// Takes over a mount rotation.
    pub fn set_mount(&mut self, fit: &mount::Mount, from: Pedigree<'_>) {
        let value = fit.r_tip_sensor.quat().scaled_axis().map(f64::to_degrees);
        self.mount_deg = Some(from.entry(value.into(), fit.sigma_rad.map(f64::to_degrees).into()));
    }
    /// The numbers alone, ready for every sample.
    #[must_use]
    pub fn correction(&self) -> Correction {
        let vector = |e: &Option<Entry<[f64; 3]>>| e.as_ref().map_or_else(Vector3::zeros, |e| e.value.into());
        let table = |e: &Option<Entry<Rows>>| e.as_ref().map_or_else(Matrix3::identity, |e| matrix(&e.value));
        let mount = UnitQuaternion::from_scaled_axis(vector(&self.mount_deg).map(f64::to_radians)).to_rotation_matrix().into_inner();
        Correction {
            gyro_bias_rad_s: vector(&self.gyro_bias_rad_s),
            gyro_matrix: mount,
            acc_bias_m_s2: vector(&self.acc_bias_m_s2),
            acc_matrix: mount * table(&self.acc_matrix),
            mag_bias_ut: vector(&self.mag_bias_ut),
            mag_matrix: mount * table(&self.mag_matrix),
        }
    }
}

/// A calibration without its pedigree: small, copied, allocates nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Subtracted from the gyroscope, rad/s.
    pub gyro_bias_rad_s: Vector3<f64>,
    /// Applied to the gyroscope after that: the mount.
    pub gyro_matrix: Matrix3<f64>,
    /// Subtracted from the accelerometer, m/s².
    pub acc_bias_m_s2: Vector3<f64>,
    /// Applied to the accelerometer after that: scale, then the mount.
    pub acc_matrix: Matrix3<f64>,
    /// Subtracted from the magnetometer, µT.
    pub mag_bias_ut: Vector3<f64>,
    /// Applied to the magnetometer after that: soft iron, then the mount.
    pub mag_matrix: Matrix3<f64>,
}

impl Correction {
    /// Changes nothing.
    pub const NONE: Self = Self {
        gyro_bias_rad_s: Vector3::new(0.0, 0.0, 0.0),
        gyro_matrix: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        acc_bias_m_s2: Vector3::new(0.0, 0.0, 0.0),
        acc_matrix: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        mag_bias_ut: Vector3::new(0.0, 0.0, 0.0),
        mag_matrix: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    };

    /// The sample as an ideal sensor in the tip's axes would have given it.
    #[must_use]
    pub fn apply(&self, raw: &ImuSample) -> ImuSample {
        ImuSample {
            t: raw.t,
            gyro_rad_s: self.gyro_matrix * (raw.gyro_rad_s - self.gyro_bias_rad_s),
            acc_m_s2: self.acc_matrix * (raw.acc_m_s2 - self.acc_bias_m_s2),
            mag_ut: raw.mag_ut.map(|m| self.mag_matrix * (m - self.mag_bias_ut)),
        }
    }
}

/// Corrects one sample; for many, keep [`ImuCalibration::correction`].
#[must_use]
pub fn apply(calibration: &ImuCalibration, raw: &ImuSample) -> ImuSample {
    calibration.correction().apply(raw)
}

/// Share of the sphere touched by some directions: 32 cells of equal area, four bands of z times
/// eight sectors.
#[must_use]
pub fn sphere_coverage<'a>(directions: impl Iterator<Item = &'a Vector3<f64>>) -> f64 {
    let mut touched = 0_u32;
    for d in directions {
        let n = d.norm();
        if n > 0.0 && n.is_finite() {
            let band = ((d.z / n + 1.0) * 2.0).floor().clamp(0.0, 3.0) as u32;
            let turn = (d.y.atan2(d.x) / std::f64::consts::TAU).rem_euclid(1.0);
            let sector = (turn * 8.0).floor().clamp(0.0, 7.0) as u32;
            touched |= 1 << (8 * band + sector);
        }
    }
    f64::from(touched.count_ones()) / 32.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;

    #[test]
    fn the_file_reads_back_and_missing_means_unchanged() {
        let raw = ImuSample {
            t: Seconds(1.0),
            gyro_rad_s: Vector3::new(0.1, 0.2, 0.3),
            acc_m_s2: Vector3::new(1.0, 2.0, 9.0),
            mag_ut: Some(Vector3::new(30.0, -10.0, 5.0)),
        };
        assert_eq!(apply(&ImuCalibration::default(), &raw), raw);
        assert_eq!(ImuCalibration::default().correction(), Correction::NONE);
        let from = Pedigree { date: "2025-01-31", source: "tumble.csv" };
        let calibration = ImuCalibration {
            gyro_bias_rad_s: Some(from.entry([0.1, 0.0, -0.1], [1e-4; 3])),
            mag_bias_ut: Some(from.entry([10.0, -20.0, 0.0], [0.1; 3])),
            mag_matrix: Some(from.entry([[2.0, 0.0, 0.0], [0.0, 0.5, 0.1], [0.0, 0.1, 1.0]], [[0.0; 3]; 3])),
            ..ImuCalibration::default()
        };
        let text = toml::to_string(&calibration).expect("serialises");
        let back: ImuCalibration = toml::from_str(&text).expect("reads back");
        assert_eq!(back, calibration);
        let s = apply(&back, &raw);
        assert_eq!(s.gyro_rad_s, Vector3::new(0.0, 0.2, 0.4));
        assert_eq!(s.mag_ut, Some(Vector3::new(40.0, 5.5, 6.0)));
        assert_eq!(s.acc_m_s2, raw.acc_m_s2);
        assert!(toml::from_str::<ImuCalibration>("gyro_bias = [0,0,0]").is_err());
    }

    #[test]
    fn a_mount_turns_all_three() {
        let from = Pedigree { date: "2025-01-31", source: "bends.csv" };
        let turned = ImuCalibration { mount_deg: Some(from.entry([0.0, 0.0, 90.0], [0.1; 3])), ..ImuCalibration::default() };
        let raw = ImuSample { t: Seconds(0.0), gyro_rad_s: Vector3::x(), acc_m_s2: Vector3::x(), mag_ut: Some(Vector3::x()) };
        let s = apply(&turned, &raw);
        for v in [s.gyro_rad_s, s.acc_m_s2, s.mag_ut.unwrap_or_default()] {
            assert!((v - Vector3::y()).norm() < 1e-12);
        }
    }

    #[test]
    fn coverage_counts_equal_areas() {
        assert_eq!(sphere_coverage(std::iter::empty()), 0.0);
        assert_eq!(sphere_coverage([Vector3::z(), Vector3::zeros(), Vector3::repeat(f64::NAN)].iter()), 1.0 / 32.0);
        let all: Vec<_> = (0..4000)
            .map(|i| {
                let (z, a) = ((f64::from(i) + 0.5) / 2000.0 - 1.0, f64::from(i) * 2.399_963);
                Vector3::new((1.0_f64 - z * z).sqrt() * a.cos(), (1.0_f64 - z * z).sqrt() * a.sin(), z)
            })
            .collect();
        assert_eq!(sphere_coverage(all.iter()), 1.0);
        let north: Vec<_> = all.into_iter().filter(|d| d.z > 0.0).collect();
        assert_eq!(sphere_coverage(north.iter()), 0.5);
    }
}
