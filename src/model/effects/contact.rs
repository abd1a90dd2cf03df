//! A wall stops motion one way.
//!
//! Cause: the tip meets tissue or a duct; a body can be pushed but not pulled (Signorini's condition,
//! as a penalty law: Hunt and Crossley, *J. Appl. Mech.* 1975, without the damping).
//!
//! Law: in the bend plane, with `n = (cos ψ, sin ψ)` and `o = n·b − d` the distance beyond the wall,
//! `b′ = b − P n` with `P = k (o − g ln(1 + o/g))` for o > 0: tissue stiffens as it yields, over the distance g. The
//! share k is the stiffness of the wall relative to wall and section together: 1 is a wall that is rigid once
//! it has yielded. The corner is rounded over 0.01 rad. Along the wall the tip sticks: it follows only
//! once it is μ P behind (Coulomb).
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `direction` ψ | rad | 0 ± 2 (any) | – |
//! | `distance` d | rad | 0.7 ± 0.3 | 0.3-1.2 |
//! | `stiffness` k | – | 0 ± 0.4 | 0.3-1 |
//! | `give` g | rad | 0.02 ± 0.06 | 0-0.2 |
//! | `friction` μ | – | 0 ± 0.2 | 0-0.5 |
//!
//! Signature: an error only beyond a line in the bend plane. Similar to a limit of travel,
//! `missed_steps` (which stays when the wall is left) and `cable_stiffness` (both sides alike). Approaching
//! the same bend from another side separates it.

use crate::model::effects::prelude::*;
use std::f64::consts::{FRAC_PI_4, TAU};

/// Rounding of the corner, rad.
const EDGE_RAD: f64 = 0.01;

/// A straight wall in the bend plane.
pub struct Contact;

impl Effect for Contact {
    info! {
        name: "contact",
        stage: Stage::Shape,
        signature: "an error only beyond a line in the bend plane",
        confused_with: &["missed_steps", "cable_stiffness", "stiffening"],
        separated_by: "approaching the same bend from another side",
        params: &[
            Param::new("direction", "rad", 0.0, 2.0, (-TAU, TAU)),
            Param::new("distance", "rad", 0.7, 0.3, (0.1, 1.8)),
            Param::new("stiffness", "", 0.0, 0.4, (0.0, 1.0)),
            Param::new("give", "rad", 0.02, 0.06, (0.002, 0.6)),
            Param::new("friction", "", 0.0, 0.2, (0.0, 1.5)),
        ],
    }
    /// Eight directions: a wall that the tip does not touch has no gradient towards its true direction.
    fn starts(&self) -> Starts {
        (-3..=4)
            .map(|k| vec![f64::from(k) * FRAC_PI_4, 0.45, 0.4, 0.04, 0.05])
            .collect()
    }
    /// Memory holds where along the wall the tip sticks, and whether it touches (1) or not (0).
    fn shape(&self, p: &[f64], m: &mut Memory, _at: &Moment, pose: &mut Pose) {
        let (sin, cos) = p[0].sin_cos();
        let (n, along) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let beyond = n.dot(&pose.bend) - p[1];
        let deep = overshoot(beyond, EDGE_RAD);
        let pressed = p[2] * (deep - p[3] * (deep / p[3]).ln_1p());
        pose.bend -= n * pressed;
        if p[4] > 0.0 && beyond > 0.0 {
            let (aside, hold) = (along.dot(&pose.bend), p[4] * pressed);
            let stuck = if m.0[1] > 0.0 {
                m.0[0].max(aside - hold).min(aside + hold)
            } else {
                aside
            };
            (m.0[0], m.0[1]) = (stuck, 1.0);
            pose.bend += along * (stuck - aside);
        } else {
            m.0[1] = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;
    use nalgebra::Vector3;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Contact);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Contact, &[2.1, 0.8, 0.75, 0.03, 0.1]);
    }

    fn moved(beta: f64, delta: f64) -> Vector2<f64> {
        let b = proof::bend_deg(beta, delta);
        let p = [30f64.to_radians(), 40f64.to_radians(), 0.8, 1e-6, 0.0];
        proof::shaped(&Contact, &p, b, Vector3::z()).bend - b
    }

    #[test]
    fn only_bends_beyond_the_wall_are_pushed_back() {
        for (beta, delta) in [(30.0, 30.0), (75.0, -150.0), (75.0, 120.0), (0.0, 0.0)] {
            assert!(moved(beta, delta).norm() < 1e-3, "{beta} {delta}");
        }
        let back = moved(60.0, 30.0);
        assert!((back.norm() - 0.8 * 20f64.to_radians()).abs() < 1e-3);
        assert!(
            (back.y.atan2(back.x).to_degrees() + 150.0).abs() < 1e-6,
            "straight away from the wall"
        );
    }
}
