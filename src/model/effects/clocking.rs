//! Bellows off their 120° places, or all turned alike.
//!
//! Cause: tolerance of the mould and of gluing. Law: Eq. 10 with `α_i + ζ_i`,
//! `q_i = (l − l₀) − r (b_x cos(α_i + ζ_i) − b_y sin(α_i + ζ_i))`, solved for (l, b): three equations for
//! three unknowns, linear in q. The difference from the solution at ζ = 0 is added.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `angle` ζ, one per channel | rad | 0 ± 0.1 | 0.02-0.35 (1-20°) |
//!
//! Signature: an error periodic in the direction δ that rotates the bend plane. All three alike turn
//! the plane itself: in the IMU alone that is `mount_misalignment` about the tip's axis, because the
//! base frame is refitted. Also similar to `crosstalk`. A full circle of δ separates it; a reference
//! separates the common turn.

use crate::model::effects::prelude::*;
use nalgebra::{Matrix2x3, Matrix3};
use std::f64::consts::TAU;

/// Angular places of the bellows.
pub struct Clocking;

impl Effect for Clocking {
    info! {
        name: "clocking",
        stage: Stage::Shape,
        signature: "an error periodic in the bend direction that rotates the bend plane",
        confused_with: &["mount_misalignment", "crosstalk", "cable_stiffness"],
        separated_by: "a full circle of directions; a reference for a turn of all three",
        params: &Param::new("angle", "rad", 0.0, 0.1, (-0.5, 0.5)).each(),
        starts: &[&[0.01; 3]],
    }
    /// One bellow is off its place, or all are alike: the part of the angles that the nearest of these four forms leaves.
    fn unusual(&self, p: &[f64]) -> f64 {
        let size = p.iter().map(|a| a * a).sum::<f64>();
        let alike = p.iter().sum::<f64>().powi(2) / 3.0;
        let explained = p.iter().map(|a| a * a).fold(alike, f64::max);
        if size > 0.0 {
            1.0 - explained / size
        } else {
            0.0
        }
    }
    /// Memory holds the angles and, from 3 on, the 2 × 3 matrix that follows from them, column by column.
    fn shape(&self, p: &[f64], m: &mut Memory, at: &Moment, pose: &mut Pose) {
        if m.0[..3] != p[..3] {
            m.0[..3].copy_from_slice(&p[..3]);
            let off = bend_of_lengths(&Vector3::new(p[0], p[1], p[2]))
                - bend_of_lengths(&Vector3::zeros());
            m.0[3..9].copy_from_slice(off.as_slice());
        }
        pose.bend += Matrix2x3::from_column_slice(&m.0[3..9]) * pose.bellow_mm / at.r_mm;
    }
}

/// r b per bellow length changes, for bellows off their places by ζ.
fn bend_of_lengths(zeta: &Vector3<f64>) -> Matrix2x3<f64> {
    let rows = Matrix3::from_fn(|i, j| {
        let (sin, cos) = (TAU * i as f64 / 3.0 + zeta[i]).sin_cos();
        [1.0, -cos, sin][j]
    });
    // singular only when two bellows coincide, far outside the parameters' range
    rows.try_inverse().map_or_else(Matrix2x3::zeros, |inverse| {
        inverse.fixed_rows::<2>(1).into_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::arc::Geometry;
    use crate::model::effects::tests::proof;
    use nalgebra::{Rotation2, Vector2};

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Clocking);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Clocking, &[0.1, -0.2, 0.05]);
    }

    #[test]
    fn it_inverts_equation_10_with_its_angles() {
        let g = Geometry::default();
        let zeta = Vector3::new(0.1, -0.2, 0.05);
        let b = Vector2::new(0.7, -0.4);
        let q = Vector3::from_fn(|i, _| {
            let (sin, cos) = (TAU * i as f64 / 3.0 + zeta[i]).sin_cos();
            1.5 - g.r_mm * (b.x * cos - b.y * sin)
        });
        let mut pose = Pose {
            bend: g.shape(&q).bend.0,
            twist: 0.0,
            bellow_mm: q,
        };
        assert!((pose.bend - b).norm() > 0.05);
        let at = proof::moment(0.0, Vector3::zeros());
        Clocking.shape(zeta.as_slice(), &mut Memory::default(), &at, &mut pose);
        assert!((pose.bend - b).norm() < 1e-12);
    }

    #[test]
    fn all_turned_alike_turn_the_plane() {
        for delta in [0.0, 50.0, 170.0] {
            let b = proof::bend_deg(50.0, delta);
            let out = proof::shaped(&Clocking, &[0.2; 3], b, Vector3::z()).bend;
            assert!((out - Rotation2::new(-0.2) * b).norm() < 1e-12, "{out} {b}");
        }
    }

    #[test]
    fn one_off_its_place_is_periodic_in_direction() {
        let off = |delta: f64| {
            let b = proof::bend_deg(50.0, delta);
            b.perp(&proof::shaped(&Clocking, &[0.0, 0.2, 0.0], b, Vector3::z()).bend)
                / b.norm_squared()
        };
        let turns: Vec<f64> = (0..12).map(|k| off(30.0 * f64::from(k))).collect();
        let spread = turns.iter().copied().fold(f64::MIN, f64::max)
            - turns.iter().copied().fold(f64::MAX, f64::min);
        assert!(spread > 0.05, "{turns:?}");
    }
}
