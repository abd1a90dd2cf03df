//! Twist, bend and velocity of a turned tip, with their derivatives.
//!
//! All vectors are in the axes of the base. `S` maps the sensor now to the sensor during
//! alignment; its error θ is on the left, `S_true = Exp(θ) S`.

use super::config::BendFilterConfig;
use nalgebra::{Matrix2x3, Matrix3, UnitQuaternion, Vector2, Vector3};

/// Twist of a straight tip, rad, 1 σ (0.2°).
pub(super) const TWIST_OFFSET_RAD: f64 = 0.0035;

/// Decomposition of an orientation into the twist about the axis that bending never turns about, and the bend.
pub(super) struct Twist {
    /// ψ, rad.
    pub psi: f64,
    /// ∂ψ/∂θ.
    pub psi_by_theta: Vector3<f64>,
    /// ∂ψ/∂(tilt of the axis).
    pub psi_by_tilt: Vector3<f64>,
    /// Angle between the axis during alignment and now, rad.
    pub beta: f64,
    /// ∂β/∂θ.
    pub beta_by_theta: Vector3<f64>,
}

impl Twist {
    /// `q = swing · twist`, the twist about `axis` applied first: `ψ = 2 atan2(v·a, w)` (Dobrowolski 2015).
    pub fn of(q: &UnitQuaternion<f64>, axis: &Vector3<f64>) -> Self {
        let (w, v) = (q.w, Vector3::new(q.i, q.j, q.k));
        let along = v.dot(axis);
        let size = (w * w + along * along).max(1e-12);
        // δw = −θ·v/2, δv = (w θ + θ × v)/2
        let psi_by_theta = ((axis * w + v.cross(axis)) * w + v * along) / size;
        let psi_by_tilt = v.cross(axis) * (2.0 * w / size);
        let now = q * axis;
        let across = now.cross(axis);
        let beta = across.norm().atan2(now.dot(axis));
        let bent = (beta > 1e-3).then(|| -across / across.norm());
        Self {
            psi: 2.0 * along.atan2(w),
            psi_by_theta,
            psi_by_tilt,
            beta,
            beta_by_theta: bent.unwrap_or_default(),
        }
    }
}

/// Inverse right Jacobian of SO(3) (Chirikjian 2012, eq. 10.86): change of the rotation vector per body-frame
/// rotation.
pub(crate) fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let a = phi.norm();
    let k = phi.cross_matrix();
    let c = if a < 1e-3 {
        1.0 / 12.0
    } else {
        1.0 / (a * a) - (1.0 + a.cos()) / (2.0 * a * a.sin())
    };
    Matrix3::identity() + k * 0.5 + k * k * c
}

/// Step of the difference that stands for the velocity, s.
const STEP_S: f64 = 1e-3;

/// Velocity of the sensor, m/s, when the tip at bend `b` turns at `turn_rad_s` (both in alignment axes). The sensor
/// sits `beyond_mm` past the end of an arc of constant length `arc_mm`.
pub(super) fn velocity(
    config: &BendFilterConfig,
    b: &Vector2<f64>,
    turn_rad_s: &Vector3<f64>,
) -> Vector3<f64> {
    let rate = bend_by_turn(b) * turn_rad_s;
    let ahead = b + rate * STEP_S;
    (position_mm(config, &ahead) - position_mm(config, b)) * (1e-3 / STEP_S)
}

/// Position of the sensor, mm, alignment axes with the origin at the base.
fn position_mm(config: &BendFilterConfig, b: &Vector2<f64>) -> Vector3<f64> {
    let beta = b.norm();
    let (sine, cosine) = beta.sin_cos();
    // sin β / β and (1 − cos β) / β²
    let (c0, c1) = if beta > 1e-4 {
        (sine / beta, (1.0 - cosine) / (beta * beta))
    } else {
        (1.0, 0.5)
    };
    let across = config.arc_mm * c1 + config.beyond_mm * c0;
    Vector3::new(
        across * b.x,
        -across * b.y,
        config.arc_mm * c0 + config.beyond_mm * cosine,
    )
}

/// Change of the bend vector per small rotation θ of the base frame: rows for b_x and b_y.
pub(super) fn bend_by_turn(bend: &Vector2<f64>) -> Matrix2x3<f64> {
    // b = β (cos δ, sin δ), tip axis n = (sin β cos δ, −sin β sin δ, cos β), δn = θ × n
    let beta = bend.norm();
    let (c, s) = if beta > 1e-9 {
        (bend.x / beta, bend.y / beta)
    } else {
        (1.0, 0.0)
    };
    let toward = Vector3::new(beta.cos() * c, -beta.cos() * s, -beta.sin());
    let across = Vector3::new(-s, -c, 0.0);
    let n = Vector3::new(beta.sin() * c, -beta.sin() * s, beta.cos());
    // δβ = toward · (θ × n), sin β δδ = across · (θ × n)
    let (by_beta, by_delta) = (n.cross(&toward), n.cross(&across));
    let bent = beta / beta.sin().max(0.05);
    let spread = if beta > 1e-3 { bent } else { 1.0 };
    let row_x = by_beta * c - by_delta * (s * spread);
    let row_y = by_beta * s + by_delta * (c * spread);
    Matrix2x3::from_rows(&[row_x.transpose(), row_y.transpose()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::bend::Bend;
    use crate::primitives::frames::Rotation;

    fn attitudes() -> Vec<UnitQuaternion<f64>> {
        let twisted = |x: f64, y: f64, psi: f64| {
            Bend(Vector2::new(x, y)).rotation().quat()
                * UnitQuaternion::from_scaled_axis(Vector3::z() * psi)
        };
        vec![
            twisted(0.0, 0.0, 0.0),
            twisted(0.4, -0.9, 0.1),
            twisted(-1.2, 0.3, -0.2),
            twisted(0.0, 1.4, 0.0),
        ]
    }

    fn turned(q: &UnitQuaternion<f64>, axis: usize, by: f64) -> UnitQuaternion<f64> {
        let mut v = Vector3::zeros();
        v[axis] = by;
        UnitQuaternion::from_scaled_axis(v) * q
    }

    #[test]
    fn the_twist_and_its_slopes_match_the_construction() {
        let h = 1e-6;
        let axis = UnitQuaternion::from_scaled_axis(Vector3::new(0.03, -0.05, 0.0)) * Vector3::z();
        for (q, psi) in attitudes().iter().zip([0.0, 0.1, -0.2, 0.0]) {
            let twist = Twist::of(q, &Vector3::z());
            assert!((twist.psi - psi).abs() < 1e-12, "{}", twist.psi);
            let twist = Twist::of(q, &axis);
            for j in 0..3 {
                let at = |by: f64| Twist::of(&turned(q, j, by), &axis);
                let psi_slope = (at(h).psi - at(-h).psi) / (2.0 * h);
                assert!(
                    (psi_slope - twist.psi_by_theta[j]).abs() < 1e-6,
                    "{psi_slope} {}",
                    twist.psi_by_theta
                );
                if twist.beta > 0.1 {
                    let slope = (at(h).beta - at(-h).beta) / (2.0 * h);
                    assert!(
                        (slope - twist.beta_by_theta[j]).abs() < 1e-6,
                        "{slope} {}",
                        twist.beta_by_theta
                    );
                }
                let tilted = |by: f64| {
                    let mut v = Vector3::zeros();
                    v[j] = by;
                    Twist::of(q, &(UnitQuaternion::from_scaled_axis(-v) * axis)).psi
                };
                let slope = (tilted(h) - tilted(-h)) / (2.0 * h);
                assert!(
                    (slope - twist.psi_by_tilt[j]).abs() < 1e-5,
                    "{slope} {}",
                    twist.psi_by_tilt
                );
            }
        }
    }

    #[test]
    fn the_bend_slope_equals_finite_differences() {
        let h = 1e-6;
        for q in attitudes() {
            let bend = |q: UnitQuaternion<f64>| Bend::from_rotation(&Rotation::assert_frames(q)).0;
            let rows = bend_by_turn(&bend(q));
            for j in 0..3 {
                let slope = (bend(turned(&q, j, h)) - bend(turned(&q, j, -h))) / (2.0 * h);
                assert!((slope - rows.column(j)).norm() < 1e-5, "{slope} {rows}");
            }
        }
    }

    #[test]
    fn the_sensor_velocity_follows_the_arc() {
        let config = BendFilterConfig::default();
        let reach_mm = config.arc_mm / 2.0 + config.beyond_mm;
        let near = velocity(&config, &Vector2::zeros(), &Vector3::y());
        assert!(
            (near - Vector3::x() * (reach_mm * 1e-3)).norm() < 2e-5,
            "a straight tip moves like a rod about the middle of the arc: {near}"
        );
        let b = Bend::from_deg(90.0, 0.0);
        let round = velocity(&config, &b.0, &Vector3::z());
        let radius_mm = config.arc_mm / std::f64::consts::FRAC_PI_2 + config.beyond_mm;
        assert!(
            (round.norm() - radius_mm * 1e-3).abs() < 2e-5,
            "a bent tip moves around the axis of the base: {round}"
        );
    }

    #[test]
    fn the_inverse_jacobian_matches_the_exponential_map() {
        for phi in [
            Vector3::new(0.3, -0.9, 0.0),
            Vector3::zeros(),
            Vector3::new(1e-5, 0.0, 0.0),
            Vector3::new(1.4, 0.9, 0.0),
        ] {
            let turned = |h: f64| {
                UnitQuaternion::from_scaled_axis(phi).inverse()
                    * UnitQuaternion::from_scaled_axis(phi + Vector3::y() * h)
            };
            let slope = (turned(1e-6).scaled_axis() - turned(-1e-6).scaled_axis()) / 2e-6;
            assert!((right_jacobian_inverse(&phi) * slope - Vector3::y()).norm() < 1e-5);
        }
    }
}
