//! The section as built: three bellows, each at its own distance and angle, along a circular arc.
//!
//! `q_i = Δl − r_i (b_x cos α_i − b_y sin α_i)` is three equations for `(b_x, b_y, Δl)`; with all
//! bellows in place the solution is the controller's own (paper, Eq. 10-11), which bellows out of place change.
//! The tip of an arc of length `l` lies at `(l V b_x, −l V b_y, l S)` with `S = sin β/β` and
//! `V = (1 − cos β)/β²` (Eq. 6).

use nalgebra::{Matrix3, RowVector3, Vector2, Vector3};
use std::f64::consts::TAU;

/// Frame of the proximal plate. [`crate::primitives::frames::Base`] is the attitude of the tip at the start, which
/// differs from it by the sag of the straight tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plate;

/// The unit vector of a bend direction, degrees.
pub(crate) fn toward(direction_deg: f64) -> Vector2<f64> {
    let (sin, cos) = direction_deg.to_radians().sin_cos();
    Vector2::new(cos, sin)
}

/// Where the bellows sit.
#[derive(Debug, Clone)]
pub(crate) struct Section {
    r_mm: [f64; 3],
    angle: [f64; 3],
    /// Bellow length at atmospheric pressure, mm.
    pub(crate) rest_length_mm: f64,
    solve: Matrix3<f64>,
}

impl Section {
    /// With each bellow at its distance from the axis and `offset` (rad) from its 120° place.
    pub(crate) fn new(r_mm: [f64; 3], offset: &[f64; 3], rest_length_mm: f64) -> Self {
        let angle = std::array::from_fn(|i| TAU / 3.0 * i as f64 + offset[i]);
        Self::at(r_mm, angle, rest_length_mm)
    }
    /// The same with bellows turned by `offset` (rad) about the axis.
    pub(crate) fn turned(&self, offset: &[f64; 3]) -> Self {
        let angle = std::array::from_fn(|i| self.angle[i] + offset[i]);
        Self::at(self.r_mm, angle, self.rest_length_mm)
    }
    fn at(r_mm: [f64; 3], angle: [f64; 3], rest_length_mm: f64) -> Self {
        let row = |i: usize| {
            let (sin, cos) = angle[i].sin_cos();
            RowVector3::new(-r_mm[i] * cos, r_mm[i] * sin, 1.0)
        };
        // singular only with all bellows on one line, which the allowed angles rule out
        let solve = Matrix3::from_rows(&[row(0), row(1), row(2)]).try_inverse();
        Self {
            r_mm,
            angle,
            rest_length_mm,
            solve: solve.unwrap_or_else(Matrix3::zeros),
        }
    }
    /// Bend vector, rad, and centre length, mm, for length changes of the bellows.
    pub(crate) fn shape(&self, bellow_mm: &Vector3<f64>) -> (Vector2<f64>, f64) {
        let x = self.solve * bellow_mm;
        (Vector2::new(x.x, x.y), self.rest_length_mm + x.z)
    }
}

/// S and V of a bend, and their slopes over β.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms {
    /// S = sin β / β.
    pub(crate) s: f64,
    /// V = (1 − cos β) / β².
    pub(crate) v: f64,
    /// (dS/dβ) / β.
    pub(crate) ds: f64,
    /// (dV/dβ) / β.
    pub(crate) dv: f64,
}

impl Terms {
    pub(crate) fn of(bend: &Vector2<f64>) -> Self {
        let b2 = bend.norm_squared();
        if b2 < 0.01 {
            let s = 1.0 - b2 / 6.0 * (1.0 - b2 / 20.0 * (1.0 - b2 / 42.0));
            let v = 0.5 - b2 / 24.0 * (1.0 - b2 / 30.0 * (1.0 - b2 / 56.0));
            let ds = -1.0 / 3.0 + b2 / 30.0 * (1.0 - b2 / 28.0);
            let dv = -1.0 / 12.0 + b2 / 180.0 * (1.0 - b2 / 37.333_333);
            return Self { s, v, ds, dv };
        }
        let beta = b2.sqrt();
        let (sin, cos) = beta.sin_cos();
        let (s, v) = (sin / beta, (1.0 - cos) / b2);
        Self {
            s,
            v,
            ds: (cos - s) / b2,
            dv: (s - 2.0 * v) / b2,
        }
    }
    /// Where the tip of an arc of `length_mm` lies on the plate, mm.
    pub(crate) fn tip_mm(&self, bend: &Vector2<f64>, length_mm: f64) -> Vector3<f64> {
        Vector3::new(bend.x * self.v, -bend.y * self.v, self.s) * length_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::arc::{Geometry, Shape};
    use crate::model::bend::Bend;
    use crate::primitives::units::Mm;
    use proptest::prelude::*;

    proptest! {
        /// Built to plan, it is the controller's geometry, forward and inverse.
        #[test]
        fn to_plan_it_is_nominal(x in -1.7..1.7f64, y in -1.7..1.7f64, l in 15.0..28.0f64) {
            let nominal = Geometry::default();
            let built = Section::new([nominal.r_mm; 3], &[0.0; 3], nominal.rest_length_mm);
            let want = Shape { bend: Bend(Vector2::new(x, y)), length: Mm(l) };
            let (bend, length) = built.shape(&nominal.lengths(&want));
            prop_assert!((bend - want.bend.0).norm() < 1e-9 && (length - l).abs() < 1e-9);
            let tip = Terms::of(&bend).tip_mm(&bend, length);
            prop_assert!((tip - nominal.position(&want)).norm() < 1e-6);
        }

        #[test]
        fn slopes_match_finite_differences(beta in 0.001..2.5f64) {
            let at = |b: f64| Terms::of(&Vector2::new(b, 0.0));
            let h = 1e-5;
            let t = at(beta);
            prop_assert!(((at(beta + h).s - at(beta - h).s) / (2.0 * h) / beta - t.ds).abs() < 1e-5);
            prop_assert!(((at(beta + h).v - at(beta - h).v) / (2.0 * h) / beta - t.dv).abs() < 1e-5);
        }
    }

    #[test]
    fn a_bellow_out_of_place_skews_the_bend() {
        let section =
            |offset: f64| Section::new([Geometry::default().r_mm; 3], &[offset, 0.0, 0.0], 20.0);
        let off = section(10f64.to_radians());
        let q = Geometry::default().lengths(&Shape {
            bend: Bend::from_deg(60.0, 90.0),
            length: Mm(20.0),
        });
        assert!((Bend(off.shape(&q).0).delta().to_degrees() - 90.0).abs() > 2.0);
        let all = section(0.0).turned(&[0.2; 3]);
        assert!(((Bend(all.shape(&q).0).delta() - 90f64.to_radians()).abs() - 0.2).abs() < 1e-9);
    }
}
