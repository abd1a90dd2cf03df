//! Corrections of the bend filter: gravity, field, standstill and mechanism.

use super::kalman::{ACC, GYRO, KalmanState, MAG, MOUNT, N, NIS_GATE, StateVector, TWIST};
use super::laws::{TWIST_OFFSET_RAD, Turn, Twist};
use super::state::{BendFilter, FIELD_NIS_MAX, GYRO_SIGMA_MIN_RAD_S};
use crate::estimation::fusion::align::Alignment;
use nalgebra::{UnitQuaternion, Vector3};

/// Time constant of the NIS of gravity, which indicates gyroscope drift, s.
const GRAVITY_NIS_TIME_S: f64 = 1.0;
/// Largest NIS of one gravity reading (a hundred standard deviations): limits the effect of a single reading.
const GRAVITY_NIS_MAX: f64 = 1e4;
/// Time constant of the NIS of the twist, s: a few poses.
const TWIST_NIS_TIME_S: f64 = 3.0;
/// Gains of the NIS of the field per correction: a disturbance is detected ten times faster than it is forgotten.
const FIELD_NIS_RISE: f64 = 0.1;
const FIELD_NIS_FALL: f64 = 0.01;
/// Largest ratio of the NIS of one field reading to its mean. One reading raises the mean at most elevenfold.
const FIELD_NIS_STEP_MAX: f64 = 100.0;
/// Smallest noise of accelerometer, m/s², and magnetometer, µT: a simulated source may be noise-free.
const ACC_SIGMA_MIN_M_S2: f64 = 0.005;
const MAG_SIGMA_MIN_UT: f64 = 0.05;
/// Rotation over which the mean square error of the field is averaged, rad: about three motions.
const FIELD_LEVEL_TURN_RAD: f64 = 2.0;
/// Smallest error of the field, as a fraction of it.
const FIELD_ERROR_MIN: f64 = 0.002;
/// A rate at standstill beyond this many standard deviations is motion.
const STILL_GATE: f64 = 5.0;

/// Noise of one averaged reading, as variances.
struct Noise {
    white: f64,
    direction: f64,
    /// Number of corrections over which the error of direction is correlated.
    repeats: f64,
}

impl Noise {
    fn single(&self) -> f64 {
        self.white + self.direction
    }
    /// White noise of the same effect over the correlation time.
    fn correlated(&self) -> f64 {
        self.white + self.direction * self.repeats
    }
}

impl BendFilter {
    /// Applies all corrections and transfers the estimated error into the orientation.
    pub(super) fn correct(&mut self, turn: &Turn) {
        let before = self.kalman.x;
        if !self.test_for_jump(turn) {
            if self.acc.n > 0 {
                self.correct_gravity(turn, &before);
            }
            if let (true, Some(rest)) = (self.mag.n > 0, self.alignment.mag_rest_ut) {
                self.correct_field(turn, &rest, &before);
            }
            if self.rate.n > 0 {
                self.correct_standstill(&before);
            }
            self.correct_twist();
            let theta = self.kalman.take_turn();
            self.s = UnitQuaternion::from_scaled_axis(theta) * self.s;
        }
        self.velocity_m_s[1] = self.velocity_m_s[0];
        (self.acc, self.mag, self.rate) = Default::default();
    }

    /// A persistent innovation of gravity indicates gyroscope drift, so it raises the process noise of the bias and
    /// not the noise of gravity. A brief one is an acceleration of the tip.
    fn correct_gravity(&mut self, turn: &Turn, before: &StateVector) {
        let Alignment {
            acc_rest_m_s2: rest,
            acc_sigma_m_s2,
            ..
        } = self.alignment;
        let motion = self.config.acc_motion_m_s2_per_rad_s * self.rate_rad_s;
        let white = acc_sigma_m_s2.max(ACC_SIGMA_MIN_M_S2).powi(2) / f64::from(self.acc.n)
            + motion * motion;
        let noise = self.noise(white, self.config.direction_error * rest.norm());
        let h = KalmanState::rows(ACC, &turn.slopes(&rest, &self.kalman.block(ACC)));
        let [velocity, velocity_before] = self.velocity_m_s;
        let innovation = self.acc.mean()
            - turn.s.tr_mul(&(velocity - velocity_before)) / self.since_correction_s;
        let nis = self.kalman.nis(&h, &innovation, noise.single());
        let gain = (self.config.correction_period_s / GRAVITY_NIS_TIME_S).min(1.0);
        self.gravity_nis += gain * (nis.min(GRAVITY_NIS_MAX) - self.gravity_nis);
        self.kalman
            .correct_vector(&h, &innovation, noise.correlated(), before);
    }

    /// The weight of the field follows the error that its strength and dip show. While the NIS exceeds 1, the excess counts
    /// as a further error of that kind. Beyond [`FIELD_NIS_MAX`] it grows with the square of the NIS, so that the weight of a
    /// disturbed field falls without a bound.
    fn correct_field(&mut self, turn: &Turn, rest: &Vector3<f64>, before: &StateVector) {
        let white =
            self.alignment.mag_sigma_ut.max(MAG_SIGMA_MIN_UT).powi(2) / f64::from(self.mag.n);
        let single = white + (self.config.field_error * rest.norm()).powi(2);
        let h = KalmanState::rows(MAG, &turn.slopes(rest, &self.kalman.block(MAG)));
        let nis = self.kalman.nis(&h, &self.mag.mean(), single);
        let gain = if nis > self.field_nis {
            FIELD_NIS_RISE
        } else {
            FIELD_NIS_FALL
        };
        let mean_nis =
            self.field_nis + gain * (nis.min(FIELD_NIS_STEP_MAX * self.field_nis) - self.field_nis);
        let variance = self.kalman.innovation_variance(&h, single) / 3.0;
        let persistent = (mean_nis.max(1.0) - 1.0) * (mean_nis / FIELD_NIS_MAX).max(1.0);
        let sudden = if nis > NIS_GATE {
            nis / FIELD_NIS_MAX
        } else {
            0.0
        };
        let error_ut2 = self.field_error_ut2(turn, rest) + variance * persistent.max(sudden);
        let repeats = (self.config.field_time_s / self.config.correction_period_s).max(1.0);
        self.kalman
            .correct_vector(&h, &self.mag.mean(), white + error_ut2 * repeats, before);
        self.field_nis = mean_nis;
    }

    /// Mean square error of the field per axis, µT², over the last motions: the part of the innovation that gravity and
    /// strength reveal. The third axis is the heading, whose error is what the field shall correct.
    fn field_error_ut2(&mut self, turn: &Turn, rest: &Vector3<f64>) -> f64 {
        let seen = |rest: &Vector3<f64>, bias: Vector3<f64>| turn.predicted(rest, &bias) - bias;
        let field = seen(rest, self.kalman.block(MAG));
        let gravity = seen(&self.alignment.acc_rest_m_s2, self.kalman.block(ACC));
        let innovation = self.mag.mean();
        // a vertical field has no heading
        let heading = gravity
            .cross(&field)
            .try_normalize(1e-6)
            .unwrap_or_default();
        let revealed = innovation - heading * heading.dot(&innovation);
        let turned = self.rate_rad_s * self.config.correction_period_s;
        let gain = turned / (turned + FIELD_LEVEL_TURN_RAD);
        self.field_error_ut2 += gain * (revealed.norm_squared() / 2.0 - self.field_error_ut2);
        self.field_error_ut2
            .max((FIELD_ERROR_MIN * rest.norm()).powi(2))
    }

    /// The twist is c β. Its error stays the same while the tip stays.
    fn correct_twist(&mut self) {
        // S does not contain the corrections by gravity and field yet
        let s = UnitQuaternion::from_scaled_axis(self.kalman.block(0)) * self.s;
        let (twist, c) = (Twist::of(&s, &self.axis()), self.kalman.x[TWIST]);
        let mut h = [0.0; N];
        let by_theta = twist.psi_by_theta - twist.beta_by_theta * c;
        h[..GYRO].copy_from_slice(by_theta.as_slice());
        h[TWIST] = -twist.beta;
        (h[MOUNT], h[MOUNT + 1]) = (twist.psi_by_tilt.x, twist.psi_by_tilt.y);
        let noise = self.noise(0.0, TWIST_OFFSET_RAD + self.config.twist_error * twist.beta);
        let innovation = c * twist.beta - twist.psi;
        let gain = (self.config.correction_period_s / TWIST_NIS_TIME_S).min(1.0);
        self.twist_nis += gain
            * (innovation * innovation / (self.kalman.variance(&h) + noise.direction)
                - self.twist_nis);
        self.kalman
            .correct_scalar(&h, innovation, noise.direction * noise.repeats);
    }

    /// While the pistons stand still the gyroscope measures its bias; the noise counts once per second of
    /// standstill. A rate beyond creep and drift is a turn of the base and is ignored.
    fn correct_standstill(&mut self, before: &StateVector) {
        let mean = self.rate.mean();
        let n_per_s = 1.0 / self.config.correction_period_s;
        let sigma = self.config.still_rate_sigma_rad_s;
        let noise = self.alignment.gyro_sigma_rad_s.max(GYRO_SIGMA_MIN_RAD_S);
        let r = sigma * sigma * n_per_s + noise * noise / f64::from(self.rate.n);
        let expected = sigma * sigma
            + noise * noise / f64::from(self.rate.n)
            + self.kalman.sigma_of(GYRO).powi(2);
        if mean.norm_squared() > STILL_GATE * STILL_GATE * expected {
            return;
        }
        for axis in 0..3 {
            let mut h = [0.0; N];
            h[GYRO + axis] = 1.0;
            let moved = self.kalman.x[GYRO + axis] - before[GYRO + axis];
            self.kalman.correct_scalar(&h, mean[axis] - moved, r);
        }
    }

    fn noise(&self, white: f64, direction: f64) -> Noise {
        let repeats = (self.config.direction_time_s / self.config.correction_period_s).max(1.0);
        Noise {
            white,
            direction: direction * direction,
            repeats,
        }
    }
}
