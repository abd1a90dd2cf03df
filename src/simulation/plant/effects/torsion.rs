//! Bending twists the tip about its own axis; the direction of the axis does not change.
//!
//! `T tanh(1.2 β/β₀) / tanh 1.2 · (1 + 0.2 cos 3(δ − δ₀))`: the twist levels off, and the three bellows give it
//! three lobes. `β₀ = 60°`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.torsion]`
    Torsion at "effects.torsion" sized by twist_deg; background 0.1; drawn by rng, severity {
        /// Twist T at 60° of bend, degrees. Default 0 (none); typical up to ±20. A larger value turns the camera
        /// image more.
        twist_deg: f64 = 0.0, -60.0..=60.0, "up to 20 is typical", draw rng.sign() * rng.sized(3.0, 20.0, severity);
        /// Bend direction δ₀ of the most twist, degrees. Default 0.
        direction_deg: f64 = 0.0, -360.0..=360.0, "one turn is enough", draw rng.angle_deg();
    }
}

/// Bend at which the twist is counted, rad.
const FULL: f64 = std::f64::consts::FRAC_PI_3;
/// Depth of the three lobes.
const LOBES: f64 = 0.2;

impl Law for Torsion {
    fn twist(&mut self, bend: &Vector2<f64>, _at: &Moment) -> f64 {
        let beta = bend.norm();
        let delta = bend.y.atan2(bend.x) - self.direction_deg.to_radians();
        let level = (1.2 * beta / FULL).tanh() / 1.2f64.tanh();
        self.twist_deg.to_radians() * level * (1.0 + LOBES * (3.0 * delta).cos())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twist_grows_with_bend_from_zero() {
        let mut t = Torsion {
            twist_deg: 10.0,
            direction_deg: 30.0,
        };
        let mut at = |beta: f64| t.twist(&Vector2::new(0.0, beta), &Moment { t: 0.0, dt_s: 0.0 });
        assert_eq!(at(0.0), 0.0);
        assert!(at(0.3) > 0.0 && at(0.6) > at(0.3) && at(0.6) < 2.0 * at(0.3));
        assert!((at(FULL).to_degrees() - 8.0).abs() < 0.01); // 90° is a valley of the lobes
    }
}
