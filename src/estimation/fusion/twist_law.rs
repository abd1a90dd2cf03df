//! The twist of a tip in proportion to its bend.
//!
//! A section of constant curvature cannot twist. What a tip twists nevertheless is torsion of the section, in proportion to β, and tilt of
//! the mount and sag, in proportion to the bend vector: `ψ = cᵀ (b_x, b_y, β (1 − β²/4))`. Recursive least squares over what the
//! gyroscope measures finds c and its covariance; a twist beyond that is a rotation of the base.

use crate::primitives::SURE_SIGMAS;
use nalgebra::{Matrix3, Vector2, Vector3};

crate::constants! {
    /// Prior and noise of the law.
    const LAW: LawConstants;
    /// Expected coefficients, rad/rad, 1 σ: 5.7° of twist at 57° of bend.
    prior = 0.1;
    /// Random walk of the coefficients, rad/rad/√s: .015 in a minute, as rubber warms and softens.
    walk = 0.002;
    /// Random walk of the twist that is not in proportion to bend, rad/√s.
    noise = 0.0023;
    /// Share of the twist by which it may be of another form: it levels off with the bend, and depends on the direction.
    form = 0.3;
}

/// Coefficients and their covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwistLaw {
    last: Option<Vector3<f64>>,
    c: Vector3<f64>,
    p: Matrix3<f64>,
    /// Time until it learns again, s.
    pause_s: f64,
}

impl Default for TwistLaw {
    fn default() -> Self {
        Self {
            last: None,
            c: Vector3::zeros(),
            p: Matrix3::identity() * (LAW.prior * LAW.prior),
            pause_s: 0.0,
        }
    }
}

impl TwistLaw {
    /// One tick: bend, rad, and by how much the tip has twisted, rad; returns the change of the bend vector and of its size. The law
    /// learns from it unless `disturbed`.
    pub fn step(
        &mut self,
        bend: &Vector2<f64>,
        twisted: f64,
        disturbed: bool,
        dt_s: f64,
    ) -> Vector3<f64> {
        // the rate about z of a tip twisted by c β falls short of c β̇, because the twist turns the rate of the bend as well
        let now = bend.push(bend.norm() * (1.0 - bend.norm_squared() / 4.0));
        let change = now - self.last.replace(now).unwrap_or(now);
        self.pause_s = (self.pause_s - dt_s).max(0.0);
        if !disturbed && self.pause_s == 0.0 && dt_s > 0.0 {
            self.p += Matrix3::identity() * (LAW.walk * LAW.walk * dt_s);
            let gain = self.p * change;
            let variance = change.dot(&gain) + LAW.noise * LAW.noise * dt_s;
            let innovation = twisted - self.c.dot(&change);
            if innovation.powi(2) < SURE_SIGMAS * SURE_SIGMAS * variance {
                self.c += gain * (innovation / variance);
                self.p -= gain * gain.transpose() / variance;
            }
        }
        change
    }

    /// The base turns by about `turn`, rad, about each axis, within `turns_s`: seen from where it was, the tip twists otherwise.
    pub fn forget(&mut self, turn: f64, turns_s: f64) {
        self.pause_s = turns_s;
        for i in 0..2 {
            self.p[(i, i)] += turn * turn;
        }
    }

    /// Twist of a tip whose bend has changed by this much, rad.
    pub fn twist(&self, change: &Vector3<f64>) -> f64 {
        self.c.dot(change)
    }

    /// Its variance, rad².
    pub fn variance(&self, change: &Vector3<f64>) -> f64 {
        let form = LAW.form * LAW.form * self.c.norm_squared() * change.xy().norm_squared();
        change.dot(&(self.p * change)) + form
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_law_of_a_tip_is_found_with_its_uncertainty() {
        for c in [
            Vector3::new(0.05, -0.03, 0.08),
            Vector3::new(-0.2, 0.1, 0.0),
            Vector3::zeros(),
        ] {
            let mut law = TwistLaw::default();
            let unknown = law.variance(&Vector3::x()).sqrt();
            let mut last = Vector3::zeros();
            for k in 0..8000 {
                let t = f64::from(k) * 0.005;
                let bend = Vector2::new(0.6 * (0.9 * t).sin(), 0.5 * (0.7 * t).sin());
                let now = bend.push(bend.norm() * (1.0 - bend.norm_squared() / 4.0));
                law.step(&bend, c.dot(&(now - last)), false, 0.005);
                last = now;
            }
            for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                let sigma = law.variance(&axis).sqrt();
                let miss = (law.twist(&axis) - c.dot(&axis)).abs();
                assert!(
                    miss < 3.0 * sigma && sigma < 0.2 * unknown + 0.3 * c.norm(),
                    "{c}: {miss} ± {sigma}"
                );
            }
        }
    }
}
