//! Did it leap? What a refused rate may have hidden, weighed by gravity and field.
//!
//! A rate that was refused, because it is beyond the sensor's range or beyond what pistons can do, has one
//! of two causes: the sensor erred for a moment, or the tip truly leapt, as when a wall lets go of it.
//! Neither rate nor its size tells them apart, and how far the tip went cannot be bounded by it. But
//! gravity and field read after it can: if it was a mere spike they are where the filter expects them.
//!
//! `ε² = |v − v̂|² / E|v − v̂|²` (1 on average) beyond the gate, for either of them, within a moment of the
//! refused rate says that it leapt. Then the turn is found anew by what does not need its past: with the
//! sensor's own errors as they were believed before,
//!
//! `min over θ of Σ |v − v̂(Exp(θ) S)|² / σ_v² + (c β − ψ)² / σ_ψ²`, v: gravity, field,
//!
//! in a few Gauss-Newton steps; its covariance is what these three leave open. Corrected as the small
//! error that the filter is made for, a leap would end in the biases.

use super::kalman::{ACC, Belief, MAG, TWIST};
use super::laws::{Turn, Twist};
use super::{BendFilter, TWIST_ALWAYS_RAD};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// How long after a refused rate gravity and field are asked, s.
const WEIGHED_S: f64 = 0.4;
/// Normalised innovation squared that no spike explains (four standard deviations).
const GATE: f64 = 16.0;
/// Turn that a leap may have made, rad, 1 σ.
const LEAP_RAD: f64 = 1.0;
/// Steps to the turn that explains the readings.
const STEPS: usize = 6;

/// What a refused rate may have hidden.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Reacquisition {
    /// For how long it is still asked, s.
    asked_s: f64,
    /// It leapt: the next readings say where to.
    lost: bool,
    /// It was found again since it was asked last.
    found: bool,
}

/// Normal equations of the turn: rows weighted by their variance.
struct Normal {
    a: Matrix3<f64>,
    b: Vector3<f64>,
}

impl Normal {
    fn add(&mut self, row: &Vector3<f64>, residual: f64, variance: f64) {
        self.a += row * row.transpose() / variance;
        self.b += row * (residual / variance);
    }
}

impl BendFilter {
    /// A rate was refused that may have been true: from now on it is asked whether the tip leapt.
    pub fn may_have_leapt(&mut self) {
        self.leap.asked_s = WEIGHED_S;
    }

    /// True once after each leap whose end was found.
    pub fn leapt(&mut self) -> bool {
        std::mem::take(&mut self.leap.found)
    }

    /// Before a correction: asks gravity and field while there is something to ask. True when the readings
    /// gathered for it are used up: they are from before the leap, or served to find its end.
    pub(super) fn asked(&mut self, turn: &Turn) -> bool {
        if self.leap.asked_s <= 0.0 {
            return false;
        }
        self.leap.asked_s -= self.since_correction_s;
        if self.leap.lost && self.acc.n > 0 {
            self.leap = Reacquisition { asked_s: self.leap.asked_s, lost: false, found: true };
            self.locate(turn);
            return true;
        }
        self.leap.lost |= self.gravity_gainsays(turn) || self.field_gainsays(turn);
        self.leap.lost
    }

    fn gravity_gainsays(&self, turn: &Turn) -> bool {
        let rest = self.rest.acc_rest_m_s2;
        let h = Belief::rows(ACC, &turn.slopes(&rest, &self.belief.block(ACC)));
        self.acc.n > 0 && self.belief.normalised(&h, &self.acc.mean(), self.gravity_variance()) > GATE
    }

    fn field_gainsays(&self, turn: &Turn) -> bool {
        let Some(rest) = self.rest.mag_rest_ut.filter(|_| self.mag.n > 0) else { return false };
        let h = Belief::rows(MAG, &turn.slopes(&rest, &self.belief.block(MAG)));
        self.belief.normalised(&h, &self.mag.mean(), self.field_variance(&rest)) > GATE
    }

    /// Variance of one axis of gravity while the tip turns as it does, m²/s⁴.
    fn gravity_variance(&self) -> f64 {
        let motion = self.config.acc_motion_m_s2_per_rad_s * self.turning_rad_s;
        let direction = self.config.direction_error * self.rest.acc_rest_m_s2.norm();
        self.rest.acc_sigma_m_s2.powi(2) + motion * motion + direction * direction
    }

    /// Variance of one axis of the field, µT².
    fn field_variance(&self, rest: &Vector3<f64>) -> f64 {
        self.rest.mag_sigma_ut.powi(2) + (self.config.field_error * rest.norm()).powi(2)
    }

    /// Finds the turn that explains what was gathered, and how far it is left open.
    fn locate(&mut self, turn: &Turn) {
        // what was read, on the mean
        let acc = self.acc.mean() + turn.expected(&self.rest.acc_rest_m_s2, &self.belief.block(ACC));
        let mag = self
            .rest
            .mag_rest_ut
            .filter(|_| self.mag.n > 0)
            .map(|rest| (rest, self.mag.mean() + turn.expected(&rest, &self.belief.block(MAG))));
        let mut covariance = Matrix3::identity() * (LEAP_RAD * LEAP_RAD);
        for _ in 0..STEPS {
            let here = Turn { s: self.s.to_rotation_matrix().into_inner(), ..*turn };
            let mut normal = Normal { a: Matrix3::identity() / (LEAP_RAD * LEAP_RAD), b: Vector3::zeros() };
            let sigma = self.belief.sigma_of(ACC);
            self.explain(&mut normal, &here, (ACC, &self.rest.acc_rest_m_s2, &acc), self.gravity_variance() + sigma * sigma);
            if let Some((rest, mag)) = &mag {
                let sigma = self.belief.sigma_of(MAG);
                self.explain(&mut normal, &here, (MAG, rest, mag), self.field_variance(rest) + sigma * sigma);
            }
            self.explain_twist(&mut normal);
            let Some(inverse) = normal.a.try_inverse() else { break };
            self.s = UnitQuaternion::from_scaled_axis(inverse * normal.b) * self.s;
            covariance = inverse;
        }
        self.belief.forget_turn(0.0);
        self.belief.p.fixed_view_mut::<3, 3>(0, 0).copy_from(&covariance);
        (self.mag.surprise, self.doubt) = (1.0, 1.0);
    }

    fn explain(&self, normal: &mut Normal, here: &Turn, (at, rest, read): (usize, &Vector3<f64>, &Vector3<f64>), variance: f64) {
        let bias = self.belief.block(at);
        let (by_theta, _) = here.slopes(rest, &bias);
        let residual = read - here.expected(rest, &bias);
        for axis in 0..3 {
            normal.add(&by_theta.row(axis).transpose(), residual[axis], variance);
        }
    }

    fn explain_twist(&self, normal: &mut Normal) {
        let (twist, c) = (Twist::of(&self.s, &self.axis()), self.belief.x[TWIST]);
        let row = twist.psi_by_theta - twist.beta_by_theta * c;
        let sigma = TWIST_ALWAYS_RAD + self.config.twist_error * twist.beta;
        let torsion = self.belief.p[(TWIST, TWIST)] * twist.beta * twist.beta;
        normal.add(&row, c * twist.beta - twist.psi, sigma * sigma + torsion);
    }
}
