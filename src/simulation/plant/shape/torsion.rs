//! Bending twists the tip about its own axis; the axis stays where it should be.
//!
//! `T tanh(1.2 β/β₀) / tanh 1.2 · (1 + 0.2 cos 3(δ − δ₀))`: it levels off, and three bellows make it
//! three-lobed. `β₀ = 60°`.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// `[effects.torsion]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Torsion {
    /// Twist T at 60° of bend, degrees. Default 0 (none); typical up to ±20. Bigger turns the camera
    /// image more.
    pub twist_deg: f64,
    /// Bend direction δ₀ of the most twist, degrees. Default 0.
    pub direction_deg: f64,
}

/// Bend at which the twist is counted, rad.
const FULL: f64 = std::f64::consts::FRAC_PI_3;
/// Depth of the three lobes.
const LOBES: f64 = 0.2;

impl PlantEffect for Torsion {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.torsion.twist_deg", self.twist_deg, -60.0..=60.0, "up to 20 is typical")?;
        range("effects.torsion.direction_deg", self.direction_deg, -360.0..=360.0, "one turn is enough")
    }
    fn size(&self) -> f64 {
        self.twist_deg
    }
    fn scale(&mut self, factor: f64) {
        self.twist_deg *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { twist_deg: rng.sign() * rng.sized(3.0, 20.0, severity), direction_deg: rng.angle_deg() }
    }
}

impl Torsion {
    /// Twist about the tip's axis, rad.
    pub(crate) fn twist(&self, bend: &Vector2<f64>) -> f64 {
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
    fn grows_with_bend_and_is_zero_at_rest() {
        let t = Torsion { twist_deg: 10.0, direction_deg: 30.0 };
        let at = |beta: f64| t.twist(&Vector2::new(0.0, beta));
        assert_eq!(at(0.0), 0.0);
        assert!(at(0.3) > 0.0 && at(0.6) > at(0.3) && at(0.6) < 2.0 * at(0.3));
        assert!((at(FULL).to_degrees() - 8.0).abs() < 0.01); // 90° is a valley of the lobes
    }
}
