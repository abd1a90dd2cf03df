//! Weight of the tip.
//!
//! Cause: the tip's mass sags the section by `K⁻¹` times the moment of its weight (constant-curvature
//! rod with end load: Webster and Jones, *Int. J. Robotics Research* 2010; virtual work).
//!
//! Law: the weight does work along the path `ρ(b)` of the mass, so with `up` the world's vertical in the
//! base frame `Δb_j = −G up·∂ρ/∂b_j`. The result contains the sag of the straight tip; the caller refers
//! orientations to the start.
//! `ρ = λ t + (1 − λ) 2x/l`: t the tip direction (mass on a rigid tip), x the end of the section of
//! length l (mass at its end); both have the slope 1 at straight, so `G = m g h/K` is the sag of a straight
//! section held level.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `sag` G | rad | 0 ± 0.06 | 0.02-0.17 (1-10°) |
//! | `lever` λ | – | 0.5 ± 0.3 | 0-1 |
//!
//! Signature: an error that follows the world's vertical. Similar to `accel_bias`
//! (accelerometer only), a tilted base, `curvature` (upright base: both grow with β) and `base_motion`.
//! Another attitude of the base separates it.

use crate::model::effects::prelude::*;
use crate::model::{Geometry, Shape};

/// Sag under the tip's weight.
pub struct Gravity;

impl Effect for Gravity {
    info! {
        name: "gravity",
        stage: Stage::Shape,
        signature: "an error of the bend that follows the world's vertical",
        confused_with: &["accel_bias", "curvature", "base_motion"],
        separated_by: "another attitude of the base",
        params: &[
            Param::new("sag", "rad", 0.0, 0.06, (0.0, 0.5)),
            Param::new("lever", "", 0.5, 0.3, (0.0, 1.0)),
        ],
    }
    fn shape(&self, p: &[f64], _m: &mut Memory, at: &Moment, pose: &mut Pose) {
        pose.bend -= lift(&pose.bend, &at.up_base, p[1]) * p[0];
    }
}

/// Rise of the mass per bend: `up·∂ρ/∂b`.
fn lift(bend: &Vector2<f64>, up: &Vector3<f64>, lever: f64) -> Vector2<f64> {
    // for a section of unit length: columns ∂x/∂b_x, ∂x/∂b_y, and x itself, which ends in sin β/β
    let j = Geometry::default().position_jacobian(&Shape::new(*bend, 1.0));
    let (sinc, slope_x, slope_y) = (j[(2, 2)], j[(2, 0)], j[(2, 1)]);
    let tip_x = Vector3::new(sinc + bend.x * slope_x, -bend.y * slope_x, -sinc * bend.x);
    let tip_y = Vector3::new(bend.x * slope_y, -sinc - bend.y * slope_y, -sinc * bend.y);
    let along = |tip: Vector3<f64>, column: usize| {
        up.dot(&(tip * lever + j.column(column) * (2.0 * (1.0 - lever))))
    };
    Vector2::new(along(tip_x, 0), along(tip_y, 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Bend;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Gravity);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Gravity, &[0.12, 0.2]);
    }

    /// Height of the mass above the base, per length: the function whose slope is `lift`.
    fn height(b: Vector2<f64>, up: &Vector3<f64>, lever: f64) -> f64 {
        let tip = Bend(b).rotation().apply(&Vector3::z());
        let end = Geometry::default().position(&Shape::new(b, 1.0));
        up.dot(&(tip * lever + end * (2.0 * (1.0 - lever))))
    }

    #[test]
    fn lift_is_the_slope_of_the_height() {
        let up = Vector3::new(0.48, -0.36, 0.8);
        let h = 1e-6;
        for b in [
            Vector2::new(0.3, -0.9),
            Vector2::new(-1.2, 0.4),
            Vector2::new(0.02, 0.01),
        ] {
            for lever in [0.0, 0.5, 1.0] {
                let slope = |d: Vector2<f64>| {
                    (height(b + d * h, &up, lever) - height(b - d * h, &up, lever)) / (2.0 * h)
                };
                let want = Vector2::new(slope(Vector2::x()), slope(Vector2::y()));
                assert!((lift(&b, &up, lever) - want).norm() < 1e-6, "{b} {lever}");
            }
        }
    }

    #[test]
    fn an_upright_tip_bends_further_and_a_hanging_one_less() {
        let p = proof::with(&Gravity, &[("sag", 0.1)]);
        let b = proof::bend_deg(40.0, 70.0);
        let upright = proof::shaped(&Gravity, &p, b, Vector3::z()).bend;
        let hanging = proof::shaped(&Gravity, &p, b, -Vector3::z()).bend;
        assert!(upright.norm() > b.norm() + 0.03 && hanging.norm() < b.norm() - 0.03);
        assert!((upright + hanging - 2.0 * b).norm() < 1e-12);
    }

    #[test]
    fn a_level_tip_sags_less_when_it_points_down() {
        let p = proof::with(&Gravity, &[("sag", 0.1)]);
        let level = Vector3::x();
        let at = |deg: f64| {
            let b = proof::bend_deg(deg, 180.0);
            proof::shaped(&Gravity, &p, b, level).bend - b
        };
        let further = at(75.0) - at(0.0);
        assert!(
            further.x > 0.03,
            "a tip that points down has no lever and no sag: {further}"
        );
    }
}
