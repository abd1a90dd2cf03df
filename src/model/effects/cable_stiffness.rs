//! A camera cable or irrigation line makes bending anisotropic.
//!
//! Cause: a rod of unequal second moments of area bends less across its stiff axis and is pulled
//! towards the soft one: unsymmetrical bending (Timoshenko, *Strength of Materials* part I, 3rd ed. 1955,
//! §§ 47-48; continuum arms: Camarillo et al., *IEEE Trans. Robotics* 2008).
//!
//! Law: `b′ = b + S b − w (√((b·ŵ)² + ρ²) − ρ)`, ρ = 0.1 rad, with the traceless symmetric
//! `S = [A B; B −A]`, `A + iB = s e^(2iψ)`: bends along ψ grow by s, bends across it shrink by s.
//! The trace is a common gain, which the nominal gains contain; at constant length they absorb A and B as well. A cable
//! beside the axis is pulled taut by a bend towards w and buckles in one away from it: its stiffness along w is bilinear.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `along` A, `aslant` B | – | 0 ± 0.1 | 0.02-0.2 |
//! | `taut_x`, `taut_y`: w | – | 0 ± 0.1 | 0-0.2 |
//!
//! Signature: two-fold in the direction δ. Similar to unequal k_ε (whose common-mode length
//! leaks into bend), `crosstalk` and `clocking`. Length changes separate it.

use crate::model::effects::prelude::*;

/// Bend over which the cable turns from buckled to taut, rad.
const KNEE_RAD: f64 = 0.1;

/// Two-fold anisotropy of the bend.
pub struct CableStiffness;

impl Effect for CableStiffness {
    info! {
        name: "cable_stiffness",
        stage: Stage::Shape,
        signature: "gain of the bend is two-fold in the direction",
        confused_with: &["crosstalk", "clocking", "stiffening"],
        separated_by: "length changes at several directions",
        params: &Param::new("", "", 0.0, 0.1, (-0.5, 0.5))
            .named(["along", "aslant", "taut_x", "taut_y"]),
        starts: &[&[0.02; 4]],
    }
    fn shape(&self, p: &[f64], _m: &mut Memory, _at: &Moment, pose: &mut Pose) {
        let taut = Vector2::new(p[2], p[3]);
        let towards = pose.bend.dot(&taut) / taut.norm().max(1e-12);
        let pulled = taut * (towards.hypot(KNEE_RAD) - KNEE_RAD);
        pose.bend += Matrix2::new(p[0], p[1], p[1], -p[0]) * pose.bend - pulled;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;
    use nalgebra::Vector3;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&CableStiffness);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&CableStiffness, &[0.1, -0.15, 0.05, 0.1]);
    }

    #[test]
    fn the_gain_is_two_fold_about_its_axis() {
        let psi = 25.0f64;
        let (sin, cos) = (2.0 * psi.to_radians()).sin_cos();
        let gain = |delta: f64| {
            let b = proof::bend_deg(50.0, delta);
            let out = proof::shaped(
                &CableStiffness,
                &[0.15 * cos, 0.15 * sin, 0.0, 0.0],
                b,
                Vector3::z(),
            )
            .bend;
            out.dot(&b) / b.norm_squared()
        };
        assert!((gain(psi) - 1.15).abs() < 1e-12 && (gain(psi + 90.0) - 0.85).abs() < 1e-12);
        for delta in [0.0, 33.0, 71.0] {
            assert!((gain(delta) - gain(delta + 180.0)).abs() < 1e-12);
        }
    }
}
