//! Bellows off their 120° places, a little more so the longer they are.
//!
//! A bellow glued askew runs along a helix: stretched by `q` it sits at `ζ (1 + w q / 5 mm)`.

use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::plant_effect::{PlantEffect, largest, scale_all};
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.clocking]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Clocking {
    /// How far each bellow is turned about the axis, ζ, degrees. Default 0; typical 1 to 20 on one or
    /// on all alike. All alike turn the bend's direction; one alone skews it as well.
    pub offset_deg: [f64; 3],
    /// Share w that a stretch by 5 mm adds. Default 0.08. Bigger wanders more.
    pub wander: f64,
}

impl Default for Clocking {
    fn default() -> Self {
        Self { offset_deg: [0.0; 3], wander: 0.08 }
    }
}

impl PlantEffect for Clocking {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.clocking.offset_deg", &self.offset_deg, -40.0..=40.0, "a bellow cannot pass its neighbour")?;
        range("effects.clocking.wander", self.wander, -1.0..=1.0, "a share of the offset")
    }
    fn size(&self) -> f64 {
        largest(&self.offset_deg)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.offset_deg, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sign() * rng.sized(3.0, 18.0, severity);
        let mut offset_deg = [size; 3];
        if rng.chance(0.6) {
            offset_deg = [0.0; 3];
            offset_deg[rng.channel() - 1] = size;
        }
        Self { offset_deg, wander: rng.between(0.03, 0.12) }
    }
}

/// Stretch at which the wander counts fully, mm.
const FULL_MM: f64 = 5.0;

impl Clocking {
    /// Turn of each bellow at its present stretch, rad.
    pub(crate) fn angles(&self, bellow_mm: &Vector3<f64>) -> [f64; 3] {
        std::array::from_fn(|i| self.offset_deg[i].to_radians() * (1.0 + self.wander * bellow_mm[i] / FULL_MM))
    }
}
