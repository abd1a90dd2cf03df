//! Reacquisition: tests whether a rejected rate was a true jump of the tip, and finds the orientation after it.
//!
//! A rate is rejected because it exceeds the range of the sensor or the ability of the pistons. Either the sensor
//! was disturbed for a moment, or the tip jumped, as it does when an obstruction releases it. Gravity and field
//! after the event tell the two apart: after a mere spike they are where the filter predicts them.
//!
//! A normalised innovation squared `ε² = |v − v̂|² / E|v − v̂|²` (1 on average) of either vector beyond
//! [`NIS_GATE`] within 0.4 s of the rejected rate confirms a jump. The orientation then follows
//! from measurements that do not depend on its past, with the sensor errors as estimated before,
//!
//! `min over θ of Σ |w − Exp(θ) v|² / σ_v² + (c β − ψ)² / σ_ψ²`,
//!
//! v: gravity and field as read, turned into the base, w: as expected there, in a few Gauss-Newton steps; the inverse of
//! the normal matrix is its covariance. The ordinary correction assumes small errors and would move part of the jump into
//! the biases.

use super::corrections::{NIS_GATE, rows};
use super::kalman::{ACC, MAG, N, TWIST};
use super::laws::Twist;
use super::state::BendFilter;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

crate::constants! {
    /// The test for a jump.
    const JUMP: JumpConstants;
    /// Time after a rejected rate in which gravity and field are tested, s.
    test_s = 0.4;
    /// Time between two tests, s.
    period_s = 0.02;
    /// Angle of a jump, rad, 1 σ.
    size_rad = 1.0;
}

/// Gauss-Newton steps.
const STEPS: usize = 6;

/// A world-fixed vector in the axes of the base.
struct Sight {
    /// First entry of its bias in the state.
    bias_at: usize,
    /// As read, averaged over the window.
    seen: Vector3<f64>,
    /// As expected.
    expected: Vector3<f64>,
    /// Variance of one axis.
    variance: f64,
}

impl BendFilter {
    /// Starts the test for a jump.
    pub(super) fn start_jump_test(&mut self) {
        self.reacquisition.testing_s = JUMP.test_s;
    }

    /// Time between two corrections, s.
    pub(super) fn period_s(&self) -> f64 {
        let period_s = self.config.correction_period_s;
        if self.reacquisition.testing_s > 0.0 {
            period_s.min(JUMP.period_s)
        } else {
            period_s
        }
    }

    /// Runs the test before a correction. Returns true if the averaged readings must not be used for it: they are
    /// from before the jump, or have served to find the orientation after it.
    pub(super) fn test_for_jump(&mut self) -> bool {
        if self.reacquisition.testing_s <= 0.0 {
            return false;
        }
        self.reacquisition.testing_s -= self.window.length_s;
        let sights = self.sights();
        // gravity alone leaves the heading open, so the field is waited for
        let waits = sights[1].is_none() && self.uses_field() && self.reacquisition.testing_s > 0.0;
        if self.reacquisition.lost && self.window.acc.n > 0 && !waits {
            (self.reacquisition.lost, self.reacquisition.found) = (false, true);
            self.reacquire(&sights);
            return true;
        }
        self.reacquisition.lost |= sights.iter().flatten().any(|sight| {
            let rows = rows(&[(0, sight.expected.cross_matrix())]);
            let differs = (sight.seen - sight.expected).norm_squared();
            differs > NIS_GATE * (self.bank.variance(&rows) + 3.0 * self.variance(sight))
        });
        self.reacquisition.lost
    }

    /// There is a magnetometer, and it may be used.
    pub(super) fn uses_field(&self) -> bool {
        self.config.use_mag && self.alignment.mag_rest_ut.is_some()
    }

    /// Gravity and field of the window.
    fn sights(&self) -> [Option<Sight>; 2] {
        let window = &self.window;
        let gravity = (window.acc.n > 0).then(|| Sight {
            bias_at: ACC,
            seen: window.acc.mean(),
            expected: self.expected_acc(),
            variance: self.gravity_white() + self.gravity_error(),
        });
        let expected = self.expected_mag().filter(|_| window.mag.n > 0);
        let field = expected.map(|expected| Sight {
            bias_at: MAG,
            seen: window.mag.mean() - self.field_offset,
            expected,
            variance: self.field_white() + (self.config.field_error * expected.norm()).powi(2),
        });
        [gravity, field]
    }

    /// Variance of one axis, with that of its bias.
    fn variance(&self, sight: &Sight) -> f64 {
        sight.variance + self.bank.mean_variance(sight.bias_at)
    }

    /// Finds the orientation that explains the averaged readings, and its covariance.
    fn reacquire(&mut self, sights: &[Option<Sight>; 2]) {
        let mut covariance = Matrix3::identity() * (JUMP.size_rad * JUMP.size_rad);
        let mut turn = UnitQuaternion::identity();
        let before = self.s;
        for _ in 0..STEPS {
            // normal equations, whose rows are weighted by their variance
            let mut a = Matrix3::identity() / (JUMP.size_rad * JUMP.size_rad);
            let mut b = Vector3::zeros();
            let mut add = |row: Vector3<f64>, residual: f64, variance: f64| {
                a += row * row.transpose() / variance;
                b += row * (residual / variance);
            };
            for sight in sights.iter().flatten() {
                let seen = turn * sight.seen;
                let (slope, residual) = (-seen.cross_matrix(), sight.expected - seen);
                for axis in 0..3 {
                    let row = slope.row(axis).transpose();
                    add(row, residual[axis], self.variance(sight));
                }
            }
            let (row, residual, variance) = self.twist_equation();
            add(row, residual, variance);
            let Some(inverse) = a.try_inverse() else {
                break;
            };
            turn = UnitQuaternion::from_scaled_axis(inverse * b) * turn;
            self.s = turn * before;
            covariance = inverse;
        }
        self.reset_turn(&covariance);
        self.derive();
    }

    /// Row, residual and variance of the twist that the mechanism causes.
    fn twist_equation(&self) -> (Vector3<f64>, f64, f64) {
        let (twist, c) = (Twist::of(&self.s, &self.axis()), self.twist_per_bend);
        let row = twist.psi_by_theta - twist.beta_by_theta * c;
        let sigma = self.twist_sigma_rad(twist.beta);
        let mut h = [0.0; N];
        h[TWIST] = twist.beta;
        let variance = sigma * sigma + self.bank.variance(&[h]);
        (row, c * twist.beta - twist.psi, variance)
    }
}
