//! What a window of readings says: gravity, field, standstill and mechanism.

use super::bank::{M, Noise, Reading, SWAYS};
use super::kalman::{ACC, BASE, FIELD, GYRO, MAG, MOUNT, N, Row, TWIST};
use super::laws::{TWIST_OFFSET_RAD, Twist, right_jacobian_inverse};
use super::state::{BendFilter, FIELD_NIS_MAX};
use crate::estimation::fusion::filter::TipEstimator;
use crate::primitives::{FOREIGN_SIGMAS, UNEXPLAINED_SIGMAS};
use nalgebra::{Matrix3, Vector3};

/// NIS beyond which the noise model does not explain an innovation.
pub(super) const NIS_GATE: f64 = UNEXPLAINED_SIGMAS * UNEXPLAINED_SIGMAS;

crate::constants! {
    /// Noise of the readings beside the settings of the filter. Least values are for simulated sources, which may be free of noise.
    const READINGS: ReadingNoise;
    /// Least noise of the gyroscope, rad/s.
    gyro_min_rad_s = 1e-3;
    /// Least noise of the accelerometer, m/s².
    acc_min_m_s2 = 0.005;
    /// Least noise of the magnetometer, µT.
    mag_min_ut = 0.05;
    /// Time constant of the NIS of the twist, s: a few poses.
    twist_nis_time_s = 3.0;
    /// Time constant with which the NIS of the field rises, s.
    field_nis_rise_s = 0.1;
    /// Time constant with which it falls, s: a disturbance is detected ten times faster than it is forgotten.
    field_nis_fall_s = 1.0;
    /// Largest ratio of the NIS of one field reading to its mean.
    field_nis_step_max = 100.0;
    /// Rotation over which the mean square error of the field is averaged, rad: about three motions.
    field_level_turn_rad = 2.0;
    /// Least error of the field as a fraction of it.
    field_error_min = 0.002;
    /// Least error of the field, µT.
    field_error_min_ut = 0.2;
    /// Time for which what the states leave of an error of the field stays the same, s: a pose.
    field_pose_s = 1.5;
    /// Memory of the mean square rates at standstill, s.
    still_memory_s = 8.0;
    /// Their share in what is expected next.
    still_share = 0.5;
    /// Largest mean square that counts, (rad/s)².
    still_rate2_max = 0.01;
    /// Least rate of a base that sways, rad/s.
    sway_rate_min_rad_s = 0.005;
}

/// Rows of a reading of three axes, from its slopes by the entries from a place on, three each.
pub(super) fn rows(slopes: &[(usize, Matrix3<f64>)]) -> [Row; 3] {
    let mut rows = [[0.0; N]; 3];
    for (at, slope) in slopes {
        for (axis, row) in rows.iter_mut().enumerate() {
            for j in 0..3 {
                row[at + j] = slope[(axis, j)];
            }
        }
    }
    rows
}

impl<const R: usize> Reading<R> {
    /// A reading with white noise and an error that stays the same over `windows`, as variances.
    fn new(rows: [Row; R], innovation: [f64; R], white: f64, error: f64, windows: f64) -> Self {
        let noise = Noise {
            single: [white + error; R],
            correlated: Some([white + error * windows; R]),
        };
        Self {
            rows,
            innovation,
            noise: [noise; M],
            share: 1.0 / windows,
        }
    }
}

impl BendFilter {
    /// Number of windows in which an error of the given duration stays the same.
    fn windows(&self, time_s: f64) -> f64 {
        (time_s / self.window.length_s).max(1.0)
    }

    /// Gravity without bias, in the axes of the base.
    pub(super) fn expected_acc(&self) -> Vector3<f64> {
        self.alignment.acc_rest_m_s2 - self.acc_bias + self.acc_change
    }

    /// The field without bias, in the axes of the base, where there is a magnetometer.
    pub(super) fn expected_mag(&self) -> Option<Vector3<f64>> {
        let rest = self.alignment.mag_rest_ut?;
        Some(rest - self.mag_bias + self.mag_change)
    }

    /// White noise of the mean specific force per axis, m²/s⁴.
    pub(super) fn gravity_white(&self) -> f64 {
        let motion = self.config.acc_motion_m_s2_per_rad_s * self.rate_rad_s;
        let sigma = self.alignment.acc_sigma_m_s2.max(READINGS.acc_min_m_s2);
        sigma * sigma / f64::from(self.window.acc.n.max(1)) + motion * motion
    }

    /// Error of gravity as a direction per axis, m²/s⁴.
    pub(super) fn gravity_error(&self) -> f64 {
        (self.config.direction_error * self.alignment.acc_rest_m_s2.norm()).powi(2)
    }

    /// White noise of the mean field per axis, µT².
    pub(super) fn field_white(&self) -> f64 {
        let sigma = self.alignment.mag_sigma_ut.max(READINGS.mag_min_ut);
        sigma * sigma / f64::from(self.window.mag.n.max(1))
    }

    /// Specific force less the acceleration of the sensor.
    pub(super) fn gravity(&self, accelerates: &Vector3<f64>) -> Option<Reading<3>> {
        let seen = (self.window.acc.n > 0).then_some(self.window.acc)?;
        let w = self.expected_acc();
        Some(Reading::new(
            rows(&[(0, w.cross_matrix()), (ACC, seen.by_bias())]),
            (seen.mean() - w - accelerates).into(),
            self.gravity_white(),
            self.gravity_error(),
            self.windows(self.config.direction_time_s),
        ))
    }

    /// The field, whose error in the base is a state. While the NIS exceeds 1, the excess counts as a further error. Beyond
    /// [`FIELD_NIS_MAX`] it grows with the square of the NIS, so that the weight of a disturbed field falls without a bound.
    pub(super) fn field(&mut self) -> Option<Reading<3>> {
        let seen = (self.window.mag.n > 0).then_some(self.window.mag)?;
        let w = self.expected_mag()?;
        let (by_turn, by_offset) = (w.cross_matrix(), Matrix3::identity());
        let rows = rows(&[(0, by_turn), (MAG, seen.by_bias()), (FIELD, by_offset)]);
        let white = self.field_white();
        let differs = seen.mean() - w;
        let innovation = differs - self.field_offset;
        let variance = self.bank.variance(&rows) + 3.0 * white;
        let nis = innovation.norm_squared() / variance;
        let rises = nis > self.field_nis;
        let time_s = if rises {
            READINGS.field_nis_rise_s
        } else {
            READINGS.field_nis_fall_s
        };
        let gain = (self.window.length_s / time_s).min(1.0);
        self.field_nis +=
            gain * (nis.min(READINGS.field_nis_step_max * self.field_nis) - self.field_nis);
        let persistent =
            (self.field_nis.max(1.0) - 1.0) * (self.field_nis / FIELD_NIS_MAX).max(1.0);
        let excess = nis / FIELD_NIS_MAX;
        let sudden = if nis > NIS_GATE { excess } else { 0.0 };
        self.learn_field_error(&w, &differs, white);
        let error = variance / 3.0 * persistent.max(sudden);
        let windows = self.windows(self.config.field_time_s);
        Some(Reading {
            share: 1.0 / self.windows(READINGS.field_pose_s),
            ..Reading::new(rows, innovation.into(), white, error, windows)
        })
    }

    /// Mean square error of the field over the last motions: the part that gravity and strength reveal. The third axis is the
    /// heading, whose error is what the field shall correct.
    fn learn_field_error(&mut self, w: &Vector3<f64>, differs: &Vector3<f64>, white: f64) {
        let up = self.expected_acc();
        // a vertical field has no heading
        let heading = up.cross(w).try_normalize(1e-6).unwrap_or_default();
        let revealed = differs - heading * heading.dot(differs);
        let gain = self.window.path / (self.window.path + READINGS.field_level_turn_rad);
        let now = (revealed.norm_squared() / 2.0 - white).max(0.0);
        self.field_error_ut2 += gain * (now - self.field_error_ut2);
    }

    /// Mean square error of the field per axis, µT².
    pub(super) fn field_level(&self) -> f64 {
        let norm = self.alignment.mag_rest_ut.map_or(0.0, |m| m.norm());
        let least = (READINGS.field_error_min * norm).max(READINGS.field_error_min_ut);
        self.field_error_ut2.max(least * least)
    }

    /// Standard deviation of a twist that is not c β, rad.
    pub(super) fn twist_sigma_rad(&self, beta: f64) -> f64 {
        let form = self.config.twist_form * self.twist_per_bend;
        TWIST_OFFSET_RAD + self.config.twist_error.hypot(form) * beta
    }

    /// The twist is c β.
    pub(super) fn twist(&mut self) -> Reading<1> {
        let (twist, c) = (Twist::of(&self.s, &self.axis()), self.twist_per_bend);
        let mut h = [0.0; N];
        let by_theta = twist.psi_by_theta - twist.beta_by_theta * c;
        h[..GYRO].copy_from_slice(by_theta.as_slice());
        h[BASE..FIELD].copy_from_slice(by_theta.as_slice());
        h[TWIST] = -twist.beta;
        (h[MOUNT], h[MOUNT + 1]) = (twist.psi_by_tilt.x, twist.psi_by_tilt.y);
        let innovation = c * twist.beta - twist.psi;
        let error = self.twist_sigma_rad(twist.beta).powi(2);
        let gain = (self.window.length_s / READINGS.twist_nis_time_s).min(1.0);
        let nis = innovation * innovation / (self.bank.variance(&[h]) + error);
        self.twist_nis += gain * (nis - self.twist_nis);
        let windows = self.windows(self.config.direction_time_s);
        Reading::new([h], [innovation], 0.0, error, windows)
    }

    /// While the pistons stand the gyroscope measures its bias and the rate that the tip still has. Written as the rate of
    /// the rotation vector, a tip has no third component. What the tip has shown in the other two (creep, leak, breath)
    /// counts as its own motion; a rate beyond [`FOREIGN_SIGMAS`] of it, or with a third component, is the base's.
    pub(super) fn standstill(&mut self) -> Option<Reading<3>> {
        let n = f64::from((self.window.still_n > 0).then_some(self.window.still_n)?);
        let to_phi = right_jacobian_inverse(&self.bend().rotation_vector());
        let rate = to_phi * (self.window.still / n);
        let white = self.gyro_sigma_rad_s().powi(2) / n;
        let known = self.bank.mean_variance(GYRO) + white;
        let (tip2, twist2) = (rate.xy().norm_squared() / 2.0, rate.z * rate.z);
        let gain = (self.window.length_s / READINGS.still_memory_s).min(1.0);
        let beyond = |square: f64| (square - known).clamp(0.0, READINGS.still_rate2_max);
        self.still_rate2 += gain * (beyond(tip2) - self.still_rate2);
        self.sway_rate2 += gain * (beyond(twist2) - self.sway_rate2);
        let least = self.config.still_rate_sigma_rad_s.powi(2);
        let own = least.max(READINGS.still_share * self.still_rate2.max(beyond(tip2)));
        let own = Vector3::new(own, own, self.config.still_twist_sigma_rad_s.powi(2));
        let sways = Vector3::repeat(self.sway_level());
        let nis = 2.0 * tip2 / (own.x + known) + twist2 / (own.z + known);
        let windows = self.windows(1.0);
        let noise = |v: Vector3<f64>, counts: bool| Noise {
            single: v.add_scalar(white).into(),
            correlated: counts.then(|| (v * windows).add_scalar(white).into()),
        };
        let mut all = [noise(own, nis < 3.0 * FOREIGN_SIGMAS * FOREIGN_SIGMAS); M];
        all[SWAYS] = noise(sways, false);
        Some(Reading {
            rows: rows(&[(GYRO, to_phi)]),
            innovation: rate.into(),
            noise: all,
            share: 1.0 / windows,
        })
    }

    /// Mean square rate of a base that sways, per axis, (rad/s)².
    pub(super) fn sway_level(&self) -> f64 {
        self.still_rate2
            .max(self.sway_rate2)
            .max(READINGS.sway_rate_min_rad_s * READINGS.sway_rate_min_rad_s)
    }

    /// Noise of one rate sample, rad/s.
    pub(super) fn gyro_sigma_rad_s(&self) -> f64 {
        self.alignment.gyro_sigma_rad_s.max(READINGS.gyro_min_rad_s)
    }
}
