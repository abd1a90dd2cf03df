//! A camera cable or an irrigation line beside the axis: bending across it is easy, along it is not,
//! and it pulls taut one way and buckles the other.
//!
//! With `x = b·u` the bend along the cable's side `u`, it takes back `c x (1 + o y/√(1 + y²)) u`,
//! `y = x / 0.3`.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// `[effects.cable_stiffness]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CableStiffness {
    /// Share c of the bend that the cable takes back in its own plane, mean of both ways. Default 0
    /// (none); typical 0.05 to 0.4. Bigger bends less in that plane.
    pub share: f64,
    /// Bend direction in which the cable is pulled taut, degrees. Default 0.
    pub direction_deg: f64,
    /// How much stiffer it is pulled taut than buckled, 0 to 1. Default 0.35. Bigger differs more.
    pub one_sided: f64,
}

impl Default for CableStiffness {
    fn default() -> Self {
        Self { share: 0.0, direction_deg: 0.0, one_sided: 0.35 }
    }
}

/// Bend over which it turns from buckled to taut, rad.
const KNEE: f64 = 0.3;

impl PlantEffect for CableStiffness {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.cable_stiffness.share", self.share, 0.0..=0.48, "0.05 to 0.4 is typical")?;
        range("effects.cable_stiffness.direction_deg", self.direction_deg, -360.0..=360.0, "one turn is enough")?;
        range("effects.cable_stiffness.one_sided", self.one_sided, 0.0..=1.0, "0 resists alike both ways")
    }
    fn size(&self) -> f64 {
        self.share
    }
    fn scale(&mut self, factor: f64) {
        self.share = (self.share * factor).min(0.48);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { share: rng.sized(0.1, 0.4, severity), direction_deg: rng.angle_deg(), one_sided: rng.between(0.1, 0.6) }
    }
}

/// A cable in its place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cable {
    side: Vector2<f64>,
    share: f64,
    one_sided: f64,
}

impl Cable {
    pub(crate) fn new(config: &CableStiffness) -> Self {
        let (sin, cos) = config.direction_deg.to_radians().sin_cos();
        Self { side: Vector2::new(cos, sin), share: config.share, one_sided: config.one_sided }
    }
    /// Bend that the cable takes back, rad.
    pub(crate) fn held_back(&self, bend: &Vector2<f64>) -> Vector2<f64> {
        let x = bend.dot(&self.side);
        let y = x / KNEE;
        self.side * (self.share * x * (1.0 + self.one_sided * y / (1.0 + y * y).sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_two_fold_and_stiffer_taut() {
        let c = Cable::new(&CableStiffness { share: 0.2, direction_deg: 30.0, one_sided: 0.3 });
        let along = |deg: f64| c.held_back(&Vector2::new(deg.to_radians().cos(), deg.to_radians().sin())).norm();
        assert!(along(120.0) < 1e-12 && along(300.0) < 1e-12);
        assert!(along(30.0) > along(210.0) && along(210.0) > 0.13);
    }
}
