//! Constant-curvature kinematics (paper, Eq. 6-11), forward beside inverse.
//!
//! With `b` the bend vector, `l` the centre-line length, `r` the distance of a bellow from the centre
//! and `α_i = 2π(i−1)/3`:
//!
//! * Eq. 10-11: `q_i = (l − l₀) − r (b_x cos α_i − b_y sin α_i)`, linear in `(l, b)`;
//! * Eq. 6: the tip lies at `x = Rz(−δ) [l (1 − cos β)/β, 0, l sin β/β]`.
//!
//! Eq. 6 integrates `[cos θ, 0, sin θ]` with `θ₀ = π/2`, which is written here in β = θ₀ − θ_l.

use crate::model::Bend;
use crate::primitives::Mm;
use nalgebra::{Matrix3, Vector2, Vector3};

/// The bending section's dimensions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geometry {
    /// Distance of a bellow's centre line from the backbone, mm. The paper's triangle of side
    /// T = 7 mm gives T/√3 = 4.0415.
    pub r_mm: f64,
    /// Bellow length l₀ at atmospheric pressure, mm.
    pub rest_length_mm: f64,
}

impl Default for Geometry {
    fn default() -> Self {
        Self {
            r_mm: 7.0 / 3f64.sqrt(),
            rest_length_mm: 20.0,
        }
    }
}

/// Bend and centre-line length: the paper's configuration space ψ (Eq. 3).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Shape {
    /// Bend vector.
    pub bend: Bend,
    /// Centre-line length l.
    pub length: Mm,
}

impl Shape {
    /// From a bend vector, rad, and a length, mm.
    pub fn new(bend: Vector2<f64>, length_mm: f64) -> Self {
        Self {
            bend: Bend(bend),
            length: Mm(length_mm),
        }
    }
}

impl Geometry {
    /// Direction of bellow `i` (0-based) as `(cos α_i, −sin α_i)`: the projection of a bend vector
    /// on it, times r, is what the bellow shortens by.
    pub fn spoke(i: usize) -> Vector2<f64> {
        /// √3/2 = sin 120°.
        const S: f64 = 0.866_025_403_784_438_6;
        match i {
            0 => Vector2::new(1.0, 0.0),
            1 => Vector2::new(-0.5, -S),
            _ => Vector2::new(-0.5, S),
        }
    }

    /// Eq. 10-11: change of bellow lengths q, mm, for a shape.
    pub fn lengths(&self, shape: &Shape) -> Vector3<f64> {
        let stretch = shape.length.0 - self.rest_length_mm;
        Vector3::from_fn(|i, _| stretch - self.r_mm * Self::spoke(i).dot(&shape.bend.0))
    }

    /// Inverse of [`Geometry::lengths`]: the three lengths fix bend and centre length exactly.
    pub fn shape(&self, q_mm: &Vector3<f64>) -> Shape {
        let sum = (0..3).fold(Vector2::zeros(), |a, i| a + Self::spoke(i) * q_mm[i]);
        let length_mm = self.rest_length_mm + q_mm.sum() / 3.0;
        Shape::new(sum * (-2.0 / (3.0 * self.r_mm)), length_mm)
    }

    /// Eq. 6: tip position in the base frame, mm.
    pub fn position(&self, shape: &Shape) -> Vector3<f64> {
        let beta = shape.bend.beta();
        let l = shape.length.0;
        let (b, across) = (shape.bend.0, l * versine_over(beta));
        Vector3::new(across * b.x, -across * b.y, l * sinc(beta))
    }

    /// ∂x/∂(b_x, b_y, l) of Eq. 6, mm per rad and mm per mm.
    pub fn position_jacobian(&self, shape: &Shape) -> Matrix3<f64> {
        let (b, l, beta) = (shape.bend.0, shape.length.0, shape.bend.beta());
        let (v, s) = (versine_over(beta), sinc(beta));
        // d/dβ divided by β, so that the chain rule through β = |b| has no 0/0
        let (dv, ds) = (versine_over_slope(beta), sinc_slope(beta));
        Matrix3::new(
            l * (v + b.x * b.x * dv),
            l * b.x * b.y * dv,
            v * b.x,
            -l * b.x * b.y * dv,
            -l * (v + b.y * b.y * dv),
            -v * b.y,
            l * ds * b.x,
            l * ds * b.y,
            s,
        )
    }
}

/// sin β / β.
fn sinc(beta: f64) -> f64 {
    if beta.abs() < 1e-4 {
        1.0 - beta * beta / 6.0
    } else {
        beta.sin() / beta
    }
}

/// (1 − cos β) / β².
fn versine_over(beta: f64) -> f64 {
    let half = sinc(beta / 2.0);
    0.5 * half * half
}

/// (d/dβ sinc) / β.
fn sinc_slope(beta: f64) -> f64 {
    if beta.abs() < 1e-2 {
        -1.0 / 3.0 + beta * beta / 30.0
    } else {
        (beta.cos() - sinc(beta)) / (beta * beta)
    }
}

/// (d/dβ (1 − cos β)/β²) / β.
fn versine_over_slope(beta: f64) -> f64 {
    if beta.abs() < 1e-2 {
        -1.0 / 12.0 + beta * beta / 180.0
    } else {
        (sinc(beta) - 2.0 * versine_over(beta)) / (beta * beta)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Rad;
    use proptest::prelude::*;

    fn shapes() -> impl Strategy<Value = Shape> {
        (-1.8..1.8f64, -1.8..1.8f64, 14.0..29.0f64).prop_map(|(x, y, l)| Shape {
            bend: Bend(Vector2::new(x, y)),
            length: Mm(l),
        })
    }

    proptest! {
        #[test]
        fn lengths_round_trip(s in shapes()) {
            let g = Geometry::default();
            let back = g.shape(&g.lengths(&s));
            prop_assert!((back.bend.0 - s.bend.0).norm() < 1e-9);
            prop_assert!((back.length.0 - s.length.0).abs() < 1e-9);
        }

        #[test]
        fn lengths_are_the_papers(beta in 0.0..1.6f64, delta in -3.1..3.1f64, l in 14.0..29.0f64) {
            let g = Geometry::default();
            let q = g.lengths(&Shape { bend: Bend::from_polar(Rad(beta), Rad(delta)), length: Mm(l) });
            for i in 0..3 {
                let sigma = delta + 2.0 * std::f64::consts::PI / 3.0 * i as f64;
                let want = l + g.r_mm * sigma.cos() * -beta - g.rest_length_mm;
                prop_assert!((q[i] - want).abs() < 1e-9);
            }
        }

        /// Eq. 6 by composite Simpson on the integrand as printed, θ(s) of Eq. 9.
        #[test]
        fn position_is_the_integral_of_equation_6(beta in 0.0..1.9f64, delta in -3.1..3.1f64, l in 14.0..29.0f64) {
            let g = Geometry::default();
            let theta0 = std::f64::consts::FRAC_PI_2;
            let n = 400;
            let mut integral = Vector3::zeros();
            for k in 0..=n {
                let w = if k == 0 || k == n { 1.0 } else if k % 2 == 1 { 4.0 } else { 2.0 };
                let theta = theta0 - beta * k as f64 / n as f64;
                integral += Vector3::new(theta.cos(), 0.0, theta.sin()) * w;
            }
            integral *= l / (3.0 * n as f64);
            let want = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), -delta) * integral;
            let got = g.position(&Shape { bend: Bend::from_polar(Rad(beta), Rad(delta)), length: Mm(l) });
            prop_assert!((got - want).norm() < 1e-8, "{got} {want}");
        }

        #[test]
        fn jacobians_match_finite_differences(s in shapes()) {
            let g = Geometry::default();
            let h = 1e-6;
            let moved = |j: usize, d: f64| {
                let mut m = s;
                match j { 0 => m.bend.0.x += d, 1 => m.bend.0.y += d, _ => m.length.0 += d }
                m
            };
            for j in 0..3 {
                let dx = (g.position(&moved(j, h)) - g.position(&moved(j, -h))) / (2.0 * h);
                prop_assert!((dx - g.position_jacobian(&s).column(j)).norm() < 1e-5);
            }
        }
    }

    #[test]
    fn straight_tip_points_along_z() {
        let g = Geometry::default();
        let x = g.position(&Shape {
            bend: Bend::STRAIGHT,
            length: Mm(20.0),
        });
        assert!((x - Vector3::new(0.0, 0.0, 20.0)).norm() < 1e-12);
        assert!(
            (g.position_jacobian(&Shape {
                bend: Bend::STRAIGHT,
                length: Mm(20.0)
            })[(0, 0)]
                - 10.0)
                .abs()
                < 1e-9
        );
    }
}
