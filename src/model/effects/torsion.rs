//! Bending twists the tip.
//!
//! Cause: bending and twist couple when the bellows' helix or an eccentric cable leaves the section
//! without a plane of symmetry (Rucker and Webster, *IEEE Trans. Robotics* 2011; Love, *Mathematical
//! Theory of Elasticity*, 4th ed. 1927, ch. XVIII).
//!
//! Law: `twist = c₁ β + c₂ β²` about the tip's own axis, on top of the rotation of Eq. 7.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `twist` c₁ | – (rad/rad) | 0 ± 0.08 | 0-0.25 (0-20° at 75°) |
//! | `twist_grow` c₂ | 1/rad | 0 ± 0.06 | 0-0.1 |
//!
//! Signature: yaw that grows with bend while the direction of the tip's axis is correct. Similar to errors of
//! the magnetometer, `hard_iron` and `mount_misalignment` (whose turn does not grow). A reference or a clean field
//! separates it; in the accelerometer it shows as a turn of the in-plane part.

use crate::model::effects::prelude::*;

/// Turn about the tip's axis that grows with bend.
pub struct Torsion;

impl Effect for Torsion {
    info! {
        name: "torsion",
        stage: Stage::Shape,
        signature: "yaw of the tip grows with bend while the direction of its axis is correct",
        confused_with: &["hard_iron", "mount_misalignment", "clocking"],
        separated_by: "a reference or a clean magnetic field",
        params: &[
            Param::new("twist", "", 0.0, 0.08, (-0.6, 0.6)),
            Param::new("twist_grow", "1/rad", 0.0, 0.06, (-0.4, 0.4)),
        ],
        starts: &[&[0.02, 0.0]],
    }
    fn shape(&self, p: &[f64], _m: &mut Memory, _at: &Moment, pose: &mut Pose) {
        let beta = pose.bend.norm();
        pose.twist += beta * (p[0] + p[1] * beta);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;
    use nalgebra::Vector3;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Torsion);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Torsion, &[-0.1, 0.08]);
    }

    #[test]
    fn twist_grows_with_bend_and_the_axis_stays() {
        let twist = |beta: f64, delta: f64| {
            let b = proof::bend_deg(beta, delta);
            let out = proof::shaped(&Torsion, &[0.1, 0.05], b, Vector3::z());
            assert_eq!(out.bend, b);
            out.twist
        };
        let beta = 60f64.to_radians();
        assert!((twist(60.0, 20.0) - (0.1 * beta + 0.05 * beta * beta)).abs() < 1e-12);
        assert!((twist(60.0, 20.0) - twist(60.0, -130.0)).abs() < 1e-12);
        assert!(twist(30.0, 0.0) < twist(60.0, 0.0) && twist(0.0, 0.0) == 0.0);
    }
}
