//! Bend as a vector, so that straight is the ordinary point (0, 0) and not a singular azimuth.
//!
//! `b = β (cos δ, sin δ)` with β = θ₀ − θ_l the bend angle and δ the bending plane (paper, Eq. 3).
//! Eq. 7 reads `R = Rz(−δ) Ry(β) Rz(δ)`, which is the single rotation by β about the axis
//! `(sin δ, cos δ, 0)`; in terms of `b` the rotation vector is `(b_y, b_x, 0)`.

use crate::primitives::{Base, Rad, Rotation, Tip};
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// Bend vector `β (cos δ, sin δ)` in radians.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Bend(pub Vector2<f64>);

impl Bend {
    /// The tip at rest.
    pub const STRAIGHT: Self = Self(Vector2::new(0.0, 0.0));

    /// From bend angle β and direction δ.
    pub fn from_polar(beta: Rad, delta: Rad) -> Self {
        Self(Vector2::new(beta.0 * delta.0.cos(), beta.0 * delta.0.sin()))
    }
    /// From β and δ in degrees.
    pub fn from_deg(beta_deg: f64, delta_deg: f64) -> Self {
        Self::from_polar(Rad::from_deg(beta_deg), Rad::from_deg(delta_deg))
    }
    /// β ≥ 0, radians.
    pub fn beta(&self) -> f64 {
        self.0.norm()
    }
    /// δ in (−π, π]; 0 when straight, where every δ is the same tip.
    pub fn delta(&self) -> f64 {
        self.0.y.atan2(self.0.x)
    }
    /// Rotation vector of Eq. 7, radians, in the base frame (and, being its own axis, in the tip's).
    pub fn rotation_vector(&self) -> Vector3<f64> {
        Vector3::new(self.0.y, self.0.x, 0.0)
    }
    /// Tip orientation in the base frame, Eq. 7.
    pub fn rotation(&self) -> Rotation<Base, Tip> {
        Rotation::assert_frames(UnitQuaternion::from_scaled_axis(self.rotation_vector()))
    }
    /// Inverse of [`Bend::rotation`] by the direction of the tip axis alone: a twist about that axis
    /// is ignored, as constant curvature has none. β in 0..=π.
    pub fn from_rotation(r: &Rotation<Base, Tip>) -> Self {
        Self::from_axis(&r.apply(&Vector3::z()))
    }
    /// The bend with the β of the tip axis whose direction leaves the smallest angle to `r`: where the tip
    /// has twisted as well, half of the twist goes into the direction. Of a quaternion (w, x, y, z) that
    /// direction is (y, x).
    pub fn nearest(r: &Rotation<Base, Tip>) -> Self {
        let q = r.quat().into_inner();
        let q = if q.w < 0.0 { -q } else { q };
        let across = q.i.hypot(q.j);
        let beta = 2.0 * across.atan2(q.w.hypot(q.k));
        let scale = if across > 1e-9 { beta / across } else { 2.0 };
        Self(Vector2::new(q.j * scale, q.i * scale))
    }
    /// The bend whose tip axis points along `axis` (unit, base frame):
    /// `axis = (sin β cos δ, −sin β sin δ, cos β)`.
    pub fn from_axis(axis: &Vector3<f64>) -> Self {
        let sin_beta = axis.x.hypot(axis.y);
        let beta = sin_beta.atan2(axis.z);
        // β / sin β → 1 at rest; straight back (β = π) has no direction and keeps the last digits'
        let bent = sin_beta > 1e-9;
        let scale = if bent { beta / sin_beta } else { 1.0 };
        Self(Vector2::new(axis.x * scale, -axis.y * scale))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    #[test]
    fn the_nearest_bend_has_the_beta_of_the_axis_and_the_least_angle() {
        for (beta, dir, psi) in [
            (75.0, 130.0, 0.2),
            (15.0, -40.0, -0.1),
            (0.0, 0.0, 0.1),
            (100.0, 10.0, 0.0),
        ] {
            let twist = UnitQuaternion::from_scaled_axis(Vector3::z() * psi);
            let r = Rotation::assert_frames(Bend::from_deg(beta, dir).rotation().quat() * twist);
            let near = Bend::nearest(&r);
            assert!((near.beta().to_degrees() - beta).abs() < 1e-9);
            let left = near.rotation().angle_to(&r);
            for off in [-0.02, 0.02] {
                let turned = Bend::from_polar(Rad(near.beta()), Rad(near.delta() + off));
                assert!(beta == 0.0 || turned.rotation().angle_to(&r) > left);
            }
        }
    }

    proptest! {
        #[test]
        fn is_equation_7(beta in 0.0..3.1f64, delta in -3.1..3.1f64) {
            let want = Rotation3::from_axis_angle(&Vector3::z_axis(), -delta)
                * Rotation3::from_axis_angle(&Vector3::y_axis(), beta)
                * Rotation3::from_axis_angle(&Vector3::z_axis(), delta);
            let got = Bend::from_polar(Rad(beta), Rad(delta)).rotation().quat();
            let got = got.to_rotation_matrix().into_inner();
            prop_assert!((got - want.matrix()).norm() < 1e-12);
            prop_assert!((got.transpose() * got - nalgebra::Matrix3::identity()).norm() < 1e-12);
        }

        #[test]
        fn round_trips(x in -2.0..2.0f64, y in -2.0..2.0f64) {
            let b = Bend(nalgebra::Vector2::new(x, y));
            let back = Bend::from_rotation(&b.rotation());
            prop_assert!((back.0 - b.0).norm() < 1e-9, "{b:?} -> {back:?}");
        }
    }

    #[test]
    fn straight_is_an_ordinary_point() {
        for eps in [0.0, 1e-300, 1e-12, 1e-9, 1e-8] {
            let b = Bend(nalgebra::Vector2::new(eps, -eps));
            assert!((Bend::from_rotation(&b.rotation()).0 - b.0).norm() < 1e-12);
        }
    }

    #[test]
    fn twist_is_ignored() {
        let b = Bend::from_deg(50.0, 70.0);
        let twist = Rotation::<Tip, Tip>::assert_frames(UnitQuaternion::from_scaled_axis(
            Vector3::z() * 0.3,
        ));
        assert!((Bend::from_rotation(&(b.rotation() * twist)).0 - b.0).norm() < 1e-12);
    }
}
