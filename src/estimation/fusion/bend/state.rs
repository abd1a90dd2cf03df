//! State of the bend filter, its prediction by the gyroscope, and its use as a [`TipEstimator`].

use super::config::BendFilterConfig;
use super::kalman::{ACC, GYRO, Innovation, KalmanState, MAG, MOUNT, N, TWIST};
use super::laws::{Turn, bend_by_turn, velocity};
use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::base::BaseTurn;
use crate::estimation::fusion::filter::{MeasurementMask, TipEstimator};
use crate::model::Bend;
use crate::primitives::{Base, ImuSample, Rotation, Tip};
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};

/// Initial uncertainty of the orientation, rad, 1 σ: zero by definition, but not singular.
const START_SIGMA_RAD: f64 = 1e-3;
/// Drift of the gyroscope bias during alignment, rad/s, 1 σ, beyond the error of its mean.
const BIAS_START_SIGMA_RAD_S: f64 = 2e-4;
/// Smallest gyroscope noise assumed, rad/s: a simulated source may be noise-free.
pub(super) const GYRO_SIGMA_MIN_RAD_S: f64 = 1e-3;
/// Ratio of the process noise to the noise during alignment: motion adds vibration.
const GYRO_NOISE_FACTOR: f64 = 1.5;
/// Scale error of the gyroscope, as a share of the rate, and its correlation time, s.
const GYRO_SCALE_ERROR: f64 = 0.005;
const GYRO_SCALE_TIME_S: f64 = 0.1;
/// Field NIS from which the field counts as disturbed: two standard deviations.
pub(super) const FIELD_NIS_MAX: f64 = 4.0;
/// Rate by which the tip may turn unobserved, rad/s (60 °/s), 1 σ, and the largest such angle, rad.
const UNOBSERVED_RAD_S: f64 = 1.0;
const UNOBSERVED_MAX_RAD: f64 = 0.3;

/// Test for a jump of the tip after a rejected rate; see [`super::reacquisition`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Reacquisition {
    /// Time for which the test still runs, s.
    pub testing_s: f64,
    /// A jump is confirmed, and the next readings determine the new orientation.
    pub lost: bool,
    /// The orientation was found again and not yet reported.
    pub found: bool,
}

/// The filter: estimate, covariance and averaged innovations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BendFilter {
    pub(super) config: BendFilterConfig,
    pub(super) alignment: Alignment,
    /// Sensor now to sensor during alignment.
    pub(super) s: UnitQuaternion<f64>,
    pub(super) kalman: KalmanState,
    pub(super) acc: Innovation,
    pub(super) mag: Innovation,
    pub(super) rate: Innovation,
    pub(super) since_correction_s: f64,
    /// Rate of the tip relative to the base after the last sample, rad/s.
    pub(super) rate_rad_s: f64,
    /// Running mean of the NIS of gravity. A value above 1 indicates gyroscope drift.
    pub(super) gravity_nis: f64,
    /// Running mean of the NIS of the field; 1 while the noise model holds.
    pub(super) field_nis: f64,
    /// Mean square error of the field per axis, µT².
    pub(super) field_error_ut2: f64,
    /// Running mean of the NIS of the twist.
    pub(super) twist_nis: f64,
    /// Velocity of the sensor by the bend rate, now and at the last correction, m/s, alignment axes.
    pub(super) velocity_m_s: [Vector3<f64>; 2],
    correction: Vector2<f64>,
    pub(super) reacquisition: Reacquisition,
}

impl BendFilter {
    /// A filter that starts straight, at the given alignment.
    pub fn new(config: &BendFilterConfig, alignment: &Alignment) -> Self {
        let mut sigma = [0.0; N];
        sigma[..GYRO].fill(START_SIGMA_RAD);
        sigma[GYRO..ACC].fill(
            alignment.gyro_sigma_rad_s / f64::from(alignment.samples.max(1)).sqrt()
                + BIAS_START_SIGMA_RAD_S,
        );
        sigma[ACC..MAG].fill(config.acc_bias_sigma_m_s2);
        sigma[MAG..TWIST].fill(config.mag_bias_sigma_ut);
        sigma[TWIST] = config.twist_sigma;
        sigma[MOUNT..].fill(config.mount_sigma_rad);
        let mut kalman = KalmanState::new(&sigma);
        kalman.set(GYRO, &alignment.gyro_bias_rad_s);
        Self {
            config: *config,
            alignment: *alignment,
            kalman,
            gravity_nis: 1.0,
            field_nis: 1.0,
            field_error_ut2: (config.field_error * alignment.mag_rest_ut.map_or(0.0, |m| m.norm()))
                .powi(2),
            ..Self::default()
        }
    }

    /// Restarts from an alignment `now` during which the tip was at `bend` (1 σ `sigma_rad`). The estimated sensor
    /// errors are kept.
    pub fn rebase(&mut self, now: &Alignment, bend: Bend, sigma_rad: f64) {
        // half of the twist on either side leaves the bend unchanged
        let half = UnitQuaternion::from_scaled_axis(
            Vector3::z() * (self.kalman.x[TWIST] * bend.beta() / 2.0),
        );
        self.s = half * bend.rotation().quat() * half;
        let straight = |v: &Vector3<f64>, b: Vector3<f64>| self.s * (v - b) + b;
        self.alignment.acc_rest_m_s2 = straight(&now.acc_rest_m_s2, self.kalman.block(ACC));
        self.alignment.mag_rest_ut = now
            .mag_rest_ut
            .map(|m| straight(&m, self.kalman.block(MAG)));
        self.kalman.reset_turn(sigma_rad);
        self.kalman.set(GYRO, &now.gyro_bias_rad_s);
        (self.acc, self.mag, self.rate) = (
            Innovation::default(),
            Innovation::default(),
            Innovation::default(),
        );
        (self.gravity_nis, self.field_nis, self.twist_nis) = (1.0, 1.0, 0.0);
    }

    /// Largest standard deviation of the bend, rad.
    fn bend_sigma_rad(&self) -> f64 {
        let c = self.covariance();
        // largest eigenvalue of a symmetric 2 × 2 matrix
        let (mean, half) = ((c[(0, 0)] + c[(1, 1)]) / 2.0, (c[(0, 0)] - c[(1, 1)]) / 2.0);
        (mean + half.hypot(c[(0, 1)])).max(0.0).sqrt()
    }

    /// Adds an unobserved rotation of `turn_rad` (1 σ) to the covariance.
    fn widen(&mut self, turn_rad: f64) {
        for i in 0..GYRO {
            self.kalman.p[(i, i)] += turn_rad * turn_rad;
        }
    }

    /// The alignment that zero bend refers to.
    pub fn alignment(&self) -> Alignment {
        self.alignment
    }
    /// Covariance of the bend vector, rad².
    pub fn covariance(&self) -> Matrix2<f64> {
        let rows = bend_by_turn(&self.bend().0);
        rows * self.kalman.p.fixed_view::<3, 3>(0, 0) * rows.transpose()
    }
    /// Estimated gyroscope bias, rad/s.
    pub fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.kalman.block(GYRO)
    }
    /// Estimated accelerometer bias, m/s², and the largest 1 σ of its axes.
    pub fn acc_bias_m_s2(&self) -> (Vector3<f64>, f64) {
        (self.kalman.block(ACC), self.kalman.sigma_of(ACC))
    }
    /// Estimated field of the tip's own iron, µT, and the largest 1 σ of its axes.
    pub fn mag_bias_ut(&self) -> (Vector3<f64>, f64) {
        (self.kalman.block(MAG), self.kalman.sigma_of(MAG))
    }
    /// Root mean square difference between the twist by gravity and field and that of the mechanism, over the last
    /// seconds, in standard deviations.
    pub fn twist_misfit(&self) -> f64 {
        self.twist_nis.sqrt()
    }
    /// Largest twist per bend that is consistent with the estimates, rad/rad: torsion and tilt as estimated, plus
    /// three standard deviations of both and of the non-proportional part.
    pub fn twist_per_bend_max(&self) -> f64 {
        let (x, p) = (&self.kalman.x, &self.kalman.p);
        let tilt = x[MOUNT].hypot(x[MOUNT + 1]);
        let variance = p[(TWIST, TWIST)] + p[(MOUNT, MOUNT)] + p[(MOUNT + 1, MOUNT + 1)];
        x[TWIST].abs()
            + tilt
            + 3.0 * (variance + self.config.twist_error * self.config.twist_error).sqrt()
    }

    /// The axis that bending never turns about, `Exp(−μ) z`.
    pub(super) fn axis(&self) -> Vector3<f64> {
        UnitQuaternion::from_scaled_axis(-Vector3::new(
            self.kalman.x[MOUNT],
            self.kalman.x[MOUNT + 1],
            0.0,
        )) * Vector3::z()
    }

    /// Propagates orientation and covariance over `dt_s` of measured rate.
    fn predict(&mut self, gyro: &Vector3<f64>, dt_s: f64) {
        let rate = gyro - self.gyro_bias_rad_s();
        self.rate_rad_s = rate.norm();
        let half = UnitQuaternion::from_scaled_axis(rate * (dt_s / 2.0));
        let midway = (self.s * half).to_rotation_matrix().into_inner();
        self.s = UnitQuaternion::new_normalize((self.s * half * half).into_inner());
        self.velocity_m_s[0] = velocity(&self.config, &self.bend().0, &(midway * rate), dt_s);
        self.kalman.propagate_turn(&(midway * -dt_s));
        self.add_process_noise(dt_s);
    }

    fn add_process_noise(&mut self, dt_s: f64) {
        let c = &self.config;
        let gyro = self.alignment.gyro_sigma_rad_s.max(GYRO_SIGMA_MIN_RAD_S) * GYRO_NOISE_FACTOR;
        let scale = GYRO_SCALE_ERROR * self.rate_rad_s;
        let q_turn = (gyro * gyro * dt_s + scale * scale * GYRO_SCALE_TIME_S) * dt_s;
        let drift = self.gravity_nis.sqrt().clamp(1.0, c.gyro_walk_factor_max);
        let p = &mut self.kalman.p;
        for i in 0..GYRO {
            p[(i, i)] += q_turn;
        }
        let walks = [
            (GYRO, c.gyro_walk_rad_s_rts * drift),
            (ACC, c.acc_walk_m_s2_rts),
            (MAG, c.mag_walk_ut_rts),
        ];
        for (at, walk) in walks {
            for i in at..at + 3 {
                p[(i, i)] += walk * walk * dt_s;
            }
        }
        p[(TWIST, TWIST)] += c.twist_walk * c.twist_walk * self.rate_rad_s * dt_s;
    }
}

impl TipEstimator for BendFilter {
    fn update(&mut self, sample: &ImuSample, dt_s: f64, mask: MeasurementMask, base: &BaseTurn) {
        let base_rate = self.s.inverse() * base.rate_rad_s;
        self.predict(&(sample.gyro_rad_s - base_rate), dt_s);
        let base_now = base.r_rest_now.inverse().to_rotation_matrix().into_inner();
        let turn = Turn {
            s: self.s.to_rotation_matrix().into_inner(),
            base_now,
        };
        if mask.acc {
            self.acc.add(
                &(sample.acc_m_s2
                    - turn.predicted(&self.alignment.acc_rest_m_s2, &self.kalman.block(ACC))),
            );
        }
        if let (true, Some(m), Some(rest)) = (
            self.config.use_mag && mask.mag,
            &sample.mag_ut,
            &self.alignment.mag_rest_ut,
        ) {
            self.mag
                .add(&(m - turn.predicted(rest, &self.kalman.block(MAG))));
        }
        if mask.still {
            self.rate
                .add(&(sample.gyro_rad_s - base_rate - self.gyro_bias_rad_s()));
        }
        self.since_correction_s += dt_s;
        self.correction = Vector2::zeros();
        if self.since_correction_s >= self.config.correction_period_s - 1e-9 {
            let predicted = self.bend().0;
            self.correct(&turn);
            self.since_correction_s = 0.0;
            self.correction = self.bend().0 - predicted;
        }
    }

    fn recover(
        &mut self,
        _sample: &ImuSample,
        gap_s: f64,
        _mask: MeasurementMask,
        _base: &BaseTurn,
    ) {
        self.widen((gap_s * UNOBSERVED_RAD_S).min(UNOBSERVED_MAX_RAD));
        (self.field_nis, self.gravity_nis) = (1.0, 1.0);
    }

    /// Over a gap the rate is interpolated. With an angular acceleration of at most α_max the rotation deviates from
    /// that by up to `α_max gap²/4`, taken as three standard deviations.
    fn widen_for_gap(&mut self, acceleration_max_rad_s2: f64, gap_s: f64) {
        self.widen((acceleration_max_rad_s2 * gap_s * gap_s / 12.0).min(gap_s * UNOBSERVED_RAD_S));
    }

    fn r_base_tip(&self) -> Rotation<Base, Tip> {
        Rotation::assert_frames(self.s)
    }

    fn sigma_rad(&self) -> Option<f64> {
        Some(self.bend_sigma_rad())
    }

    fn correction(&self) -> Vector2<f64> {
        self.correction
    }

    fn trusts_field(&self) -> bool {
        self.field_nis < FIELD_NIS_MAX
    }

    fn suspect_jump(&mut self) {
        self.start_jump_test();
    }

    fn take_reacquired(&mut self) -> bool {
        std::mem::take(&mut self.reacquisition.found)
    }
}
