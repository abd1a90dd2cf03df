//! How much the base sways, without an IMU on it: twist that the bend does not explain.
//!
//! A section of constant curvature cannot twist. What a tip twists in proportion to its bend is torsion of the section and tilt of the
//! mount ([`TwistLaw`]). The rest is a base that turns, which then turns the tip about the other two axes as well. Bend of the tip itself, such as breath causes, comes without twist. What the pistons do not explain is the sum of
//! both. The best linear estimate of the tip's part is that sum times its share in the mean square (Wiener 1949), so feedback that
//! takes only this share follows a disturbance of the tip and ignores a sway.

use crate::estimation::fusion::intake::share;
use crate::estimation::fusion::twist_law::TwistLaw;
use crate::primitives::LIKELY_SIGMAS;
use nalgebra::{Vector2, Vector3};

/// Memory of the mean squares, and time after which a turn is forgotten, s.
pub const MEMORY_S: f64 = 5.0;
/// Reversals of the unexplained twist, each within the time of a sway of the one before, that make a sway: one is a turn and its way back.
const SWAY_REVERSALS: u32 = 2;

crate::constants! {
    /// What counts as a sway, and what as a disturbance.
    const SWAY: SwayConstants;
    /// Time after which a sway counts as past, s: longer than the pause of a slow one.
    fade_s = 20.0;
    /// Mean square of a sway in bend from that of its twist: two of three axes bend, and a memory of 5 s shows a third to a half of it.
    per_twist = 6.0;
    /// Root mean square of the twist that the gyroscopes and the regression leave on a base that stands, rad (0.8°).
    twist_min_rad = 0.014;
    /// Largest twist that counts, rad (6°).
    twist_max_rad = 0.105;
    /// Cost of a false correction, of a sway, relative to that of a missed one, of a disturbance of the tip.
    false_correction_cost = 2.0;
    /// Bend since the beginning of a hold above which it counts no further, rad (3°): one turn of the base is no disturbance that repeats.
    disturbance_rad = 0.052;
    /// Root mean square of that bend above which something disturbs the tip again and again, rad (1.5°).
    disturbed_rad = 0.026;
    /// Largest mean square of a sway relative to that of the bend, for a tip that is disturbed.
    disturbed_share = 0.1;
}

/// Mean squares over the last seconds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sway {
    /// Twist, bend vector and its size, each without what is older than the memory, rad.
    twist: f64,
    bend: Vector3<f64>,
    /// Twist that the bend does not explain, rad².
    twist2: f64,
    /// Sign of the last significant twist, time since it, s, and how often it has changed.
    side: f64,
    rests_s: f64,
    reversals: u32,
    /// Bend since the set-point came to stand that the model does not explain, rad.
    held: Vector2<f64>,
    /// Bend that the model does not explain, rad².
    unexplained2: f64,
    /// Bend since the beginning of a hold, each limited, rad².
    disturbed2: f64,
}

impl Sway {
    /// One tick: by how much bend vector and size have changed and the tip has twisted, rad; and `side`, the sign of the twist within a
    /// motion that no law explains, 0 if that is not significant.
    pub fn step(
        &mut self,
        law: &TwistLaw,
        change: &Vector3<f64>,
        twisted: f64,
        side: f64,
        dt_s: f64,
    ) {
        let fade = 1.0 - share(dt_s, MEMORY_S);
        self.twist = self.twist * fade + twisted;
        self.bend = self.bend * fade + change;
        // what is usual of the mechanism is none of a sway
        let own = LIKELY_SIGMAS * law.variance(&self.bend).sqrt();
        let rest =
            ((self.twist - law.twist(&self.bend)).abs() - own).clamp(0.0, SWAY.twist_max_rad);
        let grows = rest * rest > self.twist2;
        let memory_s = if grows { MEMORY_S } else { SWAY.fade_s };
        self.twist2 += (rest * rest - self.twist2) * share(dt_s, memory_s);
        self.reverse(side, dt_s);
    }

    fn reverse(&mut self, side: f64, dt_s: f64) {
        self.rests_s += dt_s;
        if self.rests_s > SWAY.fade_s {
            self.reversals = 0;
        }
        if side == 0.0 {
            return;
        }
        if side == -self.side && self.rests_s <= SWAY.fade_s {
            self.reversals = self.reversals.saturating_add(1);
        }
        (self.side, self.rests_s) = (side, 0.0);
    }

    /// One tick of a hold: by how much the tip has bent beyond the model, and all that the model does not explain, rad. `None` while the
    /// set-point moves.
    pub fn hold(&mut self, held: Option<(Vector2<f64>, Vector2<f64>)>, dt_s: f64) {
        let Some((bent, unexplained)) = held else {
            self.held = Vector2::zeros();
            return;
        };
        self.held += bent;
        let k = share(dt_s, MEMORY_S);
        self.disturbed2 +=
            (self.held.norm().min(SWAY.disturbance_rad).powi(2) - self.disturbed2) * k;
        self.unexplained2 += (unexplained.norm_squared() - self.unexplained2) * k;
    }

    /// Mean square of the bend that is due to the base, rad².
    pub fn mean_square(&self) -> f64 {
        SWAY.per_twist * (self.twist2 - SWAY.twist_min_rad * SWAY.twist_min_rad).max(0.0)
    }

    /// The base turns to and fro.
    pub fn sways(&self) -> bool {
        self.reversals >= SWAY_REVERSALS
    }

    /// Something bends the tip in hold after hold, such as breath.
    pub fn is_disturbance(&self) -> bool {
        self.disturbed2 > SWAY.disturbed_rad * SWAY.disturbed_rad
            && self.mean_square() < SWAY.disturbed_share * self.disturbed2
    }

    /// Share of the unexplained bend that is due to the tip and not to a swaying base, 0 to 1; 1 for a base that stands.
    pub fn share_of_tip(&self) -> f64 {
        let sway2 = SWAY.false_correction_cost * self.mean_square();
        if sway2 > 0.0 {
            (1.0 - sway2 / self.unexplained2).clamp(0.0, 1.0)
        } else {
            1.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twenty holds of 1 s, during which the tip turns by `deg` at 0.3 Hz about an axis.
    fn swaying(axis: Vector3<f64>, deg: f64) -> Sway {
        let mut sway = Sway::default();
        let angle = |t: f64| deg.to_radians() * (std::f64::consts::TAU * 0.3 * t).sin();
        for k in 0..20 * 200 {
            let t = f64::from(k) * 0.005;
            let turned = axis * (angle(t + 0.005) - angle(t));
            let (bend, bends) = (axis.xy() * angle(t), turned.xy());
            let change = bends.push(bends.dot(&bend) / bend.norm().max(1e-9));
            sway.step(&TwistLaw::default(), &change, turned.z, 0.0, 0.005);
            sway.hold((k % 200 > 0).then_some((bends, bend)), 0.005);
        }
        sway
    }

    #[test]
    fn a_turn_with_twist_is_the_base_and_one_without_is_the_tip() {
        let still = swaying(Vector3::zeros(), 0.0);
        assert!(still.share_of_tip() == 1.0 && !still.is_disturbance());
        let breath = swaying(Vector3::new(1.0, 0.0, 0.1), 3.0);
        assert!(breath.share_of_tip() == 1.0 && breath.is_disturbance());
        let base = swaying(Vector3::new(0.6, 0.5, 0.62), 5.0);
        assert!(
            base.share_of_tip() < 0.3 && !base.is_disturbance(),
            "{}",
            base.share_of_tip()
        );
    }
}
