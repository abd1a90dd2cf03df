//! State of the bend filter, and its use as a [`TipEstimator`].

use super::bank::{Bank, M};
use super::config::BendFilterConfig;
use super::kalman::{ACC, BASE, FIELD, GYRO, MAG, MOUNT, N, SCALE, StateVector, TWIST, block};
use super::laws::bend_by_turn;
use super::window::Window;
use crate::estimation::fusion::align::Alignment;
use crate::estimation::fusion::filter::{TipEstimator, TipSample};
use crate::estimation::fusion::health::KnownErrors;
use crate::model::Bend;
use crate::primitives::{Base, LIKELY_SIGMAS, Rotation, SURE_SIGMAS, Tip};
use nalgebra::{Matrix2, Matrix3, UnitQuaternion, Vector2, Vector3};

crate::constants! {
    /// What is expected of a tip beside the settings of the filter; 1 σ where nothing else is said.
    const PRIOR: Prior;
    /// Initial uncertainty of the orientation, rad: zero by definition, but not singular.
    turn_rad = 1e-3;
    /// Drift of the gyroscope bias during alignment, rad/s, beyond the error of its mean.
    gyro_bias_rad_s = 2e-4;
    /// Error of the field during alignment, µT, beyond that of the bias.
    field_ut = 0.02;
    /// Rate by which the tip may turn unobserved, rad/s (60 °/s).
    unobserved_rad_s = 1.0;
    /// Largest angle by which it may, rad.
    unobserved_max_rad = 0.3;
    /// Tilt that the tip's sag explains, rad (1.7°).
    sag_tilt_rad = 0.03;
    /// Twist of the tip as a share of c that passes for a tilt.
    tilt_per_twist = 0.9;
    /// Angle by which a chip that is glued straight is askew about each axis, rad (0.3°).
    glued_rad = 0.0055;
}

/// Field NIS from which the field counts as disturbed.
pub(super) const FIELD_NIS_MAX: f64 = LIKELY_SIGMAS * LIKELY_SIGMAS;

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

/// What follows from the estimate after a correction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Derived {
    /// Base as it is known to have turned to base now.
    base_turn: UnitQuaternion<f64>,
    /// Sensor to tip.
    mount: UnitQuaternion<f64>,
    /// Covariance of the bend vector, rad².
    covariance: Matrix2<f64>,
}

/// The filter: nominal values, hypotheses around them, and the readings since the last correction.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BendFilter {
    pub(super) config: BendFilterConfig,
    pub(super) alignment: Alignment,
    /// Sensor now to the base as it is known to have turned.
    pub(super) s: UnitQuaternion<f64>,
    /// Gyroscope bias, rad/s, and scale error.
    pub(super) gyro_bias: Vector3<f64>,
    pub(super) gyro_scale: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub(super) acc_bias: Vector3<f64>,
    /// Field of the tip's own iron, µT.
    pub(super) mag_bias: Vector3<f64>,
    /// Error of the field in the base, µT.
    pub(super) field_offset: Vector3<f64>,
    /// c, rad/rad.
    pub(super) twist_per_bend: f64,
    /// μ, rad.
    tilt: Vector2<f64>,
    pub(super) bank: Bank,
    /// Variances over the hypotheses after the last correction.
    variances: StateVector,
    derived: Derived,
    pub(super) window: Window,
    /// Changes since alignment of the specific force, m/s², and of the field, µT, that the turn of the base explains.
    pub(super) acc_change: Vector3<f64>,
    pub(super) mag_change: Vector3<f64>,
    /// Rate of the tip relative to the base after the last sample: its size, rad/s, and in the axes of the base.
    pub(super) rate_rad_s: f64,
    pub(super) turn_rate: Vector3<f64>,
    /// Running mean of the NIS of the field; 1 while the noise model holds.
    pub(super) field_nis: f64,
    /// Mean square error of the field per axis, µT².
    pub(super) field_error_ut2: f64,
    /// Running mean of the NIS of the twist.
    pub(super) twist_nis: f64,
    /// Mean square rates at standstill of bend and of twist, (rad/s)².
    pub(super) still_rate2: f64,
    pub(super) sway_rate2: f64,
    /// Velocity of the sensor by the bend rate at the end of the last window, m/s, axes of the base.
    pub(super) velocity_m_s: Option<Vector3<f64>>,
    correction: Vector2<f64>,
    pub(super) reacquisition: Reacquisition,
}

impl BendFilter {
    /// A filter that starts straight, at the given alignment.
    pub fn new(config: &BendFilterConfig, alignment: &Alignment) -> Self {
        let mut sigma = [0.0; N];
        let mean = alignment.gyro_sigma_rad_s / f64::from(alignment.samples.max(1)).sqrt();
        sigma[..GYRO].fill(PRIOR.turn_rad);
        sigma[GYRO..ACC].fill(mean + PRIOR.gyro_bias_rad_s);
        sigma[ACC..MAG].fill(config.acc_bias_sigma_m_s2);
        sigma[MAG..TWIST].fill(config.mag_bias_sigma_ut);
        sigma[TWIST] = config.twist_sigma;
        sigma[MOUNT..BASE].fill(config.mount_sigma_rad);
        sigma[FIELD..SCALE].fill(PRIOR.field_ut);
        sigma[SCALE..].fill(config.gyro_scale_sigma);
        let field_ut = alignment.mag_rest_ut.map_or(0.0, |m| m.norm());
        let mut filter = Self {
            config: *config,
            alignment: *alignment,
            gyro_bias: alignment.gyro_bias_rad_s,
            bank: Bank::new(&sigma),
            field_nis: 1.0,
            field_error_ut2: (config.field_error * field_ut).powi(2),
            ..Self::default()
        };
        filter.derive();
        filter
    }

    /// Restarts from an alignment `now` during which the tip was at `bend` (1 σ `sigma_rad`). The estimated sensor
    /// errors are kept.
    pub fn rebase(&mut self, now: &Alignment, bend: Bend, sigma_rad: f64) {
        // half of the twist on either side leaves the bend unchanged
        let half_rad = self.twist_per_bend * bend.beta() / 2.0;
        let half = UnitQuaternion::from_scaled_axis(Vector3::z() * half_rad);
        self.s = half * bend.rotation().quat() * half;
        let straight = |v: &Vector3<f64>, b: Vector3<f64>| self.s * (v - b) + b;
        self.alignment.acc_rest_m_s2 = straight(&now.acc_rest_m_s2, self.acc_bias);
        self.alignment.mag_rest_ut = now.mag_rest_ut.map(|m| straight(&m, self.mag_bias));
        self.reset_turn(&(Matrix3::identity() * (sigma_rad * sigma_rad)));
        self.gyro_bias = now.gyro_bias_rad_s;
        self.twist_nis = 0.0;
        self.derive();
    }

    /// Sets the covariance of the orientation, for a base that stands.
    pub(super) fn reset_turn(&mut self, covariance: &Matrix3<f64>) {
        for filter in &mut self.bank.filters {
            filter.reset(0, covariance);
            filter.reset(BASE, &Matrix3::zeros());
        }
        (self.window, self.field_nis) = (Window::default(), 1.0);
    }

    /// Adds an unobserved rotation of `turn_rad` (1 σ) to the covariance.
    fn widen(&mut self, turn_rad: f64) {
        for filter in &mut self.bank.filters {
            filter.widen(0, turn_rad * turn_rad);
        }
    }

    /// Probabilities that gyroscope and base are steady, that the bias of the gyroscope drifts fast, that it drifts slowly, that its
    /// rate is wrong, and that the base sways.
    pub fn probabilities(&self) -> [f64; M] {
        self.bank.probability
    }
    /// Bend of the tip if the base had stood since the alignment.
    pub fn bend_on_standing_base(&self) -> Bend {
        let mount = &self.derived.mount;
        Bend::nearest(&Rotation::assert_frames(mount * self.s * mount.inverse()))
    }
    /// Estimated gyroscope bias, rad/s.
    pub fn gyro_bias_rad_s(&self) -> Vector3<f64> {
        self.gyro_bias
    }
    /// Estimated sensor errors, with margins of three standard deviations.
    pub fn known_errors(&self) -> KnownErrors {
        KnownErrors {
            acc_bias_m_s2: self.acc_bias,
            acc_margin_m_s2: SURE_SIGMAS * self.sigma_of(ACC),
            iron_ut: self.mag_bias,
            iron_margin_ut: SURE_SIGMAS * self.sigma_of(MAG),
        }
    }
    /// Largest standard deviation of three entries from `at` on.
    fn sigma_of(&self, at: usize) -> f64 {
        block(&self.variances, at).max().max(0.0).sqrt()
    }
    /// Root mean square difference between the twist by gravity and field and that of the mechanism, over the last
    /// seconds, in standard deviations.
    pub fn twist_misfit(&self) -> f64 {
        self.twist_nis.sqrt()
    }
    /// Variance of the estimated gyroscope bias about the least certain axis, (rad/s)².
    pub fn gyro_bias_variance(&self) -> f64 {
        self.sigma_of(GYRO).powi(2)
    }

    /// The axis that bending never turns about, `Exp(−μ) z`.
    pub(super) fn axis(&self) -> Vector3<f64> {
        UnitQuaternion::from_scaled_axis(-self.tilt.push(0.0)) * Vector3::z()
    }

    /// Applies all corrections and transfers the estimated errors into the nominal values.
    fn correct(&mut self) {
        self.propagate();
        let accelerates = self.accelerates();
        if self.test_for_jump() {
            self.window = Window::default();
            return;
        }
        let twist = self.twist();
        let readings = [self.gravity(&accelerates), self.field(), self.standstill()];
        for reading in readings.iter().flatten() {
            self.bank.correct(reading);
        }
        self.bank.correct(&twist);
        self.bank.weigh();
        self.take_errors();
        let change = self.config.change_per_s * self.window.length_s;
        self.bank.mix(change);
        self.derive();
        self.window = Window::default();
    }

    /// Moves the nominal values by the mean error. The rotation of the base stays with the hypothesis.
    fn take_errors(&mut self) {
        let mean = self.bank.mean();
        let mut taken = mean;
        taken.fixed_rows_mut::<3>(BASE).fill(0.0);
        for filter in &mut self.bank.filters {
            filter.x -= taken;
        }
        self.s = UnitQuaternion::from_scaled_axis(block(&mean, 0)) * self.s;
        self.gyro_bias += block(&mean, GYRO);
        self.acc_bias += block(&mean, ACC);
        self.mag_bias += block(&mean, MAG);
        self.twist_per_bend += mean[TWIST];
        self.tilt += Vector2::new(mean[MOUNT], mean[MOUNT + 1]);
        self.field_offset += block(&mean, FIELD);
        self.gyro_scale += block(&mean, SCALE);
    }

    /// Updates what follows from the estimate.
    ///
    /// A chip that is tilted by more than the sag of the tip and the form of its torsion explain is mounted askew, and its axes are turned
    /// back. A chip that is askew by μ about x and y is so about z too, by as much per axis; nothing but the covariance shows that.
    pub(super) fn derive(&mut self) {
        let mean = self.bank.mean();
        self.variances = self.bank.variances(&mean);
        let size = self.tilt.norm();
        let explained = PRIOR
            .sag_tilt_rad
            .hypot(PRIOR.tilt_per_twist * self.twist_per_bend);
        let askew = 1.0 - (explained / size.max(1e-9)).powi(2).min(1.0);
        let mount = self.tilt.push(0.0) * askew;
        self.derived.mount = UnitQuaternion::from_scaled_axis(mount);
        self.derived.base_turn = UnitQuaternion::from_scaled_axis(block(&mean, BASE));
        let turn = self.bank.turn_covariance(&mean);
        let r = self.r_base_tip();
        let by_mount = Matrix3::identity() - r.quat().to_rotation_matrix().into_inner();
        let glued2 = PRIOR.glued_rad * PRIOR.glued_rad;
        let across = |i: usize| glued2 + askew * self.variances[i];
        let beyond = size
            - (PRIOR.sag_tilt_rad * PRIOR.sag_tilt_rad / size.max(PRIOR.sag_tilt_rad)).min(size);
        let about_z = glued2 + beyond * beyond;
        let mounts =
            Matrix3::from_diagonal(&Vector3::new(across(MOUNT), across(MOUNT + 1), about_z));
        let rows = bend_by_turn(&self.bend().0);
        let total = turn + by_mount * mounts * by_mount.transpose();
        self.derived.covariance = rows * total * rows.transpose();
    }
}

impl TipEstimator for BendFilter {
    fn update(&mut self, sample: &TipSample) {
        self.predict(sample);
        self.correction = Vector2::zeros();
        if self.window.length_s >= self.period_s() - 1e-9 {
            self.follow_base(&sample.base);
            let predicted = self.bend().0;
            self.correct();
            self.correction = self.bend().0 - predicted;
        }
    }

    fn recover(&mut self, sample: &TipSample) {
        self.widen((sample.dt_s * PRIOR.unobserved_rad_s).min(PRIOR.unobserved_max_rad));
        (self.window, self.field_nis) = (Window::default(), 1.0);
        self.velocity_m_s = None;
        // many short steps instead of a long one, because the corrections are large
        self.start_jump_test();
    }

    /// Over a gap the rate is interpolated. With an angular acceleration of at most α_max the rotation deviates from
    /// that by up to `α_max gap²/4`, taken as three standard deviations.
    fn widen_for_gap(&mut self, acceleration_max_rad_s2: f64, gap_s: f64) {
        self.widen(
            (acceleration_max_rad_s2 * gap_s * gap_s / 12.0).min(gap_s * PRIOR.unobserved_rad_s),
        );
    }

    fn r_base_tip(&self) -> Rotation<Base, Tip> {
        let (turn, mount) = (&self.derived.base_turn, &self.derived.mount);
        Rotation::assert_frames(mount * turn * self.s * mount.inverse())
    }

    fn covariance(&self) -> Option<Matrix2<f64>> {
        Some(self.derived.covariance)
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
