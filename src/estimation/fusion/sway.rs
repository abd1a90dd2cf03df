//! How much the base sways, without an IMU on it: twist while the pistons stand.
//!
//! A section of constant curvature cannot twist, so a tip that twists during a hold is carried by its base, which then turns the
//! tip about the other two axes as well. Bend of the tip itself, such as breath causes, comes without twist. What the pistons do
//! not explain is the sum of both. The best linear estimate of the tip's part is that sum times its share in the mean square
//! (Wiener 1949), so feedback that takes only this share follows a disturbance of the tip and ignores a sway.

use crate::estimation::fusion::intake::share;
use nalgebra::{Vector2, Vector3};

/// Memory of the mean squares, s of hold.
const HOLDS_S: f64 = 5.0;
/// Mean square of a sway from that of its twist since the beginning of a hold: two of three axes bend, a hold shows a third of a sway
/// of 0.2 Hz, and half of the square is attributed to the tip, which makes 12. Twice that trusts the feedforward more: what a sway
/// too slow for a hold hides would all be taken for bending.
const SWAY_PER_TWIST: f64 = 24.0;
/// Largest twist per bend that is attributed to the tip beside a sway, which also raises what the estimator finds.
const TORSION_MAX: f64 = 0.2;
/// Sway that is no more than the error of the gyroscopes, rad (0.3°).
const SWAY_MIN_RAD: f64 = 0.005;
/// Bend since the beginning of a hold above which it counts no further, rad (3°): one turn of the base is no disturbance that repeats.
const DISTURBANCE_RAD: f64 = 0.052;
/// Root mean square of that bend above which something disturbs the tip again and again, rad (1.5°).
const DISTURBED_RAD: f64 = 0.026;
/// Largest mean square of a sway relative to that of the bend, for a tip that is disturbed.
const DISTURBED_SHARE: f64 = 0.1;

/// Mean squares over the last holds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sway {
    /// Rotation since the set-point came to stand that the model does not explain, rad: bend vector and twist.
    held: Vector3<f64>,
    /// Sway of the base, rad².
    sway2: f64,
    /// Bend that the model does not explain, rad².
    unexplained2: f64,
    /// Bend since the beginning of a hold, each at most [`DISTURBANCE_RAD`], rad².
    disturbed2: f64,
}

impl Sway {
    /// The set-point moves.
    pub fn depart(&mut self) {
        self.held = Vector3::zeros();
    }

    /// One tick of a hold: what the tip has turned beyond the model (bend vector and twist, rad), the twist per bend of the tip
    /// itself, and all that the model does not explain, rad.
    pub fn step(&mut self, turned: &Vector3<f64>, twist_per_bend: f64, unexplained: &Vector2<f64>, dt_s: f64) {
        self.held += turned;
        let bend = self.held.xy().norm();
        let twist = (self.held.z.abs() - twist_per_bend.min(TORSION_MAX) * bend).max(0.0);
        let k = share(dt_s, HOLDS_S);
        self.sway2 += (SWAY_PER_TWIST * twist * twist - self.sway2) * k;
        self.disturbed2 += (bend.min(DISTURBANCE_RAD).powi(2) - self.disturbed2) * k;
        self.unexplained2 += (unexplained.norm_squared() - self.unexplained2) * k;
    }

    /// Something bends the tip in hold after hold, such as breath.
    pub fn is_disturbance(&self) -> bool {
        self.disturbed2 > DISTURBED_RAD * DISTURBED_RAD && self.sway2 < DISTURBED_SHARE * self.disturbed2
    }

    /// Share of the unexplained bend that is due to the tip and not to a swaying base, 0 to 1; 1 for a base that stands.
    pub fn share_of_tip(&self) -> f64 {
        let sway2 = (self.sway2 - SWAY_MIN_RAD * SWAY_MIN_RAD).max(0.0);
        if sway2 > 0.0 { (1.0 - sway2 / self.unexplained2).clamp(0.0, 1.0) } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twenty holds of 1 s, during which the tip turns by 3° at 0.3 Hz about an axis.
    fn swaying(axis: Vector3<f64>) -> Sway {
        let mut sway = Sway::default();
        let angle = |t: f64| 3f64.to_radians() * (std::f64::consts::TAU * 0.3 * t).sin();
        for k in 0..20 * 200 {
            let t = f64::from(k) * 0.005;
            if k % 200 == 0 {
                sway.depart();
            }
            sway.step(&(axis * (angle(t + 0.005) - angle(t))), 0.3, &(axis.xy() * angle(t)), 0.005);
        }
        sway
    }

    #[test]
    fn a_turn_with_twist_is_the_base_and_one_without_is_the_tip() {
        let still = swaying(Vector3::zeros());
        assert!(still.share_of_tip() == 1.0 && !still.is_disturbance());
        let breath = swaying(Vector3::new(1.0, 0.0, 0.1));
        assert!(breath.share_of_tip() == 1.0 && breath.is_disturbance());
        let base = swaying(Vector3::new(0.6, 0.5, 0.62));
        assert!(base.share_of_tip() < 0.3 && !base.is_disturbance(), "{}", base.share_of_tip());
    }
}
