//! The tip bends by more or less than constant curvature says, alike in all directions.
//!
//! Cause: end pieces, shear and a stiffness that varies along the section leave an arc that is not a
//! circle (Webster and Jones, *Int. J. Robotics Research* 2010, §2). A varying curvature changes the tip's
//! *position* but not its orientation; only a change of the total bend is modelled here.
//!
//! Law: `b′ = b (1 + c₁ P₁(x) + c₂ P₂(x))`, `x = β/75°`, with `P₁ = x − 3/4` and
//! `P₂ = x² − 4x/3 + 2/5`. Both are orthogonal to a constant under the weight x², so the gains, which
//! absorb every constant factor, do not change.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `bow` c₁ | – | 0 ± 0.1 | 0.02-0.3 (1-10° at 75°) |
//! | `curl` c₂ | – | 0 ± 0.2 | 0-0.4 |
//!
//! Signature: an isotropic function of β. Similar to `stiffening` (depends on the length of
//! each bellow, too) and `gravity`. Length changes or a shape sensor separate it.

use crate::model::effects::prelude::*;

/// Bend at which x is 1: 75°, rad.
const REACH_RAD: f64 = 75.0 * std::f64::consts::PI / 180.0;

/// Isotropic curve of bend over bend.
pub struct Curvature;

impl Effect for Curvature {
    info! {
        name: "curvature",
        stage: Stage::Shape,
        signature: "bend is off by a function of the bend angle, alike in all directions",
        confused_with: &["stiffening", "gravity"],
        separated_by: "the same bends at another length; a shape sensor",
        params: &[
            Param::new("bow", "", 0.0, 0.1, (-0.8, 0.8)),
            Param::new("curl", "", 0.0, 0.2, (-1.0, 1.0)),
        ],
        starts: &[&[0.03, 0.0]],
    }
    fn shape(&self, p: &[f64], _m: &mut Memory, _at: &Moment, pose: &mut Pose) {
        let x = pose.bend.norm() / REACH_RAD;
        pose.bend *= 1.0 + p[0] * (x - 0.75) + p[1] * (x * x - 4.0 / 3.0 * x + 0.4);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;
    use nalgebra::Vector3;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Curvature);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Curvature, &[-0.2, 0.15]);
    }

    fn gain(p: &[f64], beta: f64, delta: f64) -> f64 {
        let b = proof::bend_deg(beta, delta);
        let out = proof::shaped(&Curvature, p, b, Vector3::z()).bend;
        assert!(b.perp(&out).abs() < 1e-12, "the plane stays");
        out.norm() / b.norm()
    }

    #[test]
    fn the_change_is_isotropic_and_grows_with_bend() {
        let p = [0.2, 0.1];
        for delta in [40.0, 160.0, -100.0] {
            assert!((gain(&p, 60.0, delta) - gain(&p, 60.0, 0.0)).abs() < 1e-12);
        }
        assert!(gain(&[0.2, 0.0], 75.0, 10.0) - gain(&[0.2, 0.0], 15.0, 10.0) > 0.15);
    }

    /// The best constant gain over a ladder of bends is 1.
    #[test]
    fn the_gains_do_not_change() {
        for p in [[0.2, 0.0], [0.0, 0.2]] {
            let (mut top, mut bottom) = (0.0, 0.0);
            for k in 1..=750 {
                let beta = 0.1 * f64::from(k);
                top += beta * beta * gain(&p, beta, 30.0);
                bottom += beta * beta;
            }
            assert!((top / bottom - 1.0).abs() < 1e-3, "{p:?} {}", top / bottom);
        }
    }
}
