//! Reacquisition: tests whether a rejected rate was a true jump of the tip, and finds the orientation after it.
//!
//! A rate is rejected because it exceeds the range of the sensor or the ability of the pistons. Either the sensor
//! was disturbed for a moment, or the tip jumped, as it does when an obstruction releases it. Gravity and field
//! after the event tell the two apart: after a mere spike they are where the filter predicts them.
//!
//! A normalised innovation squared `ε² = |v − v̂|² / E|v − v̂|²` (1 on average) of either vector beyond
//! [`NIS_GATE`] within [`TEST_S`] of the rejected rate confirms a jump. The orientation then follows
//! from measurements that do not depend on its past, with the sensor errors as estimated before,
//!
//! `min over θ of Σ |v − v̂(Exp(θ) S)|² / σ_v² + (c β − ψ)² / σ_ψ²`, v: gravity, field,
//!
//! in a few Gauss-Newton steps; the inverse of the normal matrix is its covariance. The ordinary correction assumes
//! small errors and would move part of the jump into the biases.

use super::kalman::{ACC, KalmanState, MAG, NIS_GATE, TWIST};
use super::laws::{TWIST_OFFSET_RAD, Turn, Twist};
use super::state::{BendFilter, Reacquisition};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Time after a rejected rate in which gravity and field are tested, s.
const TEST_S: f64 = 0.4;
/// Angle of a jump, rad, 1 σ.
const JUMP_RAD: f64 = 1.0;
/// Gauss-Newton steps.
const STEPS: usize = 6;

/// Normal equations of the orientation error; rows are weighted by their variance.
struct NormalEquations {
    a: Matrix3<f64>,
    b: Vector3<f64>,
}

impl NormalEquations {
    fn add(&mut self, row: &Vector3<f64>, residual: f64, variance: f64) {
        self.a += row * row.transpose() / variance;
        self.b += row * (residual / variance);
    }
}

/// Reading of a world-fixed vector, averaged over a correction.
struct Reading {
    /// First entry of its bias in the state.
    bias_at: usize,
    /// Reading during alignment.
    rest: Vector3<f64>,
    /// Reading now.
    now: Vector3<f64>,
    /// Variance of one axis.
    variance: f64,
}

impl BendFilter {
    /// Starts the test for a jump.
    pub(super) fn start_jump_test(&mut self) {
        self.reacquisition.testing_s = TEST_S;
    }

    /// Runs the test before a correction. Returns true if the averaged readings must not be used for it: they are
    /// from before the jump, or have served to find the orientation after it.
    pub(super) fn test_for_jump(&mut self, turn: &Turn) -> bool {
        if self.reacquisition.testing_s <= 0.0 {
            return false;
        }
        self.reacquisition.testing_s -= self.since_correction_s;
        if self.reacquisition.lost && self.acc.n > 0 {
            self.reacquisition = Reacquisition {
                lost: false,
                found: true,
                ..self.reacquisition
            };
            self.reacquire(turn);
            return true;
        }
        let contradicts =
            |at: usize, rest: &Vector3<f64>, innovation: &Vector3<f64>, variance: f64| {
                let h = KalmanState::rows(at, &turn.slopes(rest, &self.kalman.block(at)));
                self.kalman.nis(&h, innovation, variance) > NIS_GATE
            };
        let rest = &self.alignment.acc_rest_m_s2;
        let gravity =
            self.acc.n > 0 && contradicts(ACC, rest, &self.acc.mean(), self.gravity_variance());
        let field = self.alignment.mag_rest_ut.filter(|_| self.mag.n > 0);
        let jumped = gravity
            || field.is_some_and(|rest| {
                contradicts(MAG, &rest, &self.mag.mean(), self.field_variance(&rest))
            });
        self.reacquisition.lost |= jumped;
        self.reacquisition.lost
    }

    /// Variance of one axis of gravity at the present rate of the tip, m²/s⁴.
    fn gravity_variance(&self) -> f64 {
        let motion = self.config.acc_motion_m_s2_per_rad_s * self.rate_rad_s;
        let direction = self.config.direction_error * self.alignment.acc_rest_m_s2.norm();
        self.alignment.acc_sigma_m_s2.powi(2) + motion * motion + direction * direction
    }

    /// Variance of one axis of the field, µT².
    fn field_variance(&self, rest: &Vector3<f64>) -> f64 {
        self.alignment.mag_sigma_ut.powi(2) + (self.config.field_error * rest.norm()).powi(2)
    }

    fn reading(
        &self,
        turn: &Turn,
        bias_at: usize,
        rest: Vector3<f64>,
        innovation: Vector3<f64>,
        variance: f64,
    ) -> Reading {
        let sigma = self.kalman.sigma_of(bias_at);
        let now = innovation + turn.predicted(&rest, &self.kalman.block(bias_at));
        Reading {
            bias_at,
            rest,
            now,
            variance: variance + sigma * sigma,
        }
    }

    /// Finds the orientation that explains the averaged readings, and its covariance.
    fn reacquire(&mut self, turn: &Turn) {
        let gravity = self.reading(
            turn,
            ACC,
            self.alignment.acc_rest_m_s2,
            self.acc.mean(),
            self.gravity_variance(),
        );
        let rest = self.alignment.mag_rest_ut.filter(|_| self.mag.n > 0);
        let field = rest
            .map(|rest| self.reading(turn, MAG, rest, self.mag.mean(), self.field_variance(&rest)));
        let mut covariance = Matrix3::identity() * (JUMP_RAD * JUMP_RAD);
        for _ in 0..STEPS {
            let here = Turn {
                s: self.s.to_rotation_matrix().into_inner(),
                ..*turn
            };
            let mut normal = NormalEquations {
                a: Matrix3::identity() / (JUMP_RAD * JUMP_RAD),
                b: Vector3::zeros(),
            };
            for reading in std::iter::once(&gravity).chain(&field) {
                self.add_reading(&mut normal, &here, reading);
            }
            self.add_twist(&mut normal);
            let Some(inverse) = normal.a.try_inverse() else {
                break;
            };
            self.s = UnitQuaternion::from_scaled_axis(inverse * normal.b) * self.s;
            covariance = inverse;
        }
        self.kalman.reset_turn(0.0);
        self.kalman
            .p
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&covariance);
        (self.field_nis, self.gravity_nis) = (1.0, 1.0);
    }

    fn add_reading(&self, normal: &mut NormalEquations, here: &Turn, reading: &Reading) {
        let bias = self.kalman.block(reading.bias_at);
        let (by_theta, _) = here.slopes(&reading.rest, &bias);
        let residual = reading.now - here.predicted(&reading.rest, &bias);
        for axis in 0..3 {
            normal.add(
                &by_theta.row(axis).transpose(),
                residual[axis],
                reading.variance,
            );
        }
    }

    fn add_twist(&self, normal: &mut NormalEquations) {
        let (twist, c) = (Twist::of(&self.s, &self.axis()), self.kalman.x[TWIST]);
        let row = twist.psi_by_theta - twist.beta_by_theta * c;
        let sigma = TWIST_OFFSET_RAD + self.config.twist_error * twist.beta;
        let torsion = self.kalman.p[(TWIST, TWIST)] * twist.beta * twist.beta;
        normal.add(&row, c * twist.beta - twist.psi, sigma * sigma + torsion);
    }
}
