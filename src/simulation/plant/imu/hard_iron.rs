//! Magnetised parts that turn with the sensor, and parts that take time to be magnetised.
//!
//! A constant body-fixed field `b`, plus `v |b|` along the field that the parts have been in over the
//! last 15 s (magnetic viscosity).

use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::memory::Decay;
use crate::simulation::plant::plant_effect::{PlantEffect, largest, scale_all};
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.hard_iron]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HardIron {
    /// Field b of the parts, µT per axis. Default 0 (none); typical 1 to 50. Bigger turns the heading
    /// more.
    pub offset_ut: [f64; 3],
    /// Share v that follows slowly. Default 0.1. Bigger remembers attitudes more.
    pub viscous: f64,
}

impl Default for HardIron {
    fn default() -> Self {
        Self { offset_ut: [0.0; 3], viscous: 0.1 }
    }
}

/// Time over which parts are magnetised, s.
const VISCOUS_S: f64 = 15.0;

impl PlantEffect for HardIron {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.hard_iron.offset_ut", &self.offset_ut, -500.0..=500.0, "1 to 50 µT is typical")?;
        range("effects.hard_iron.viscous", self.viscous, 0.0..=1.0, "0.1 is typical")
    }
    fn size(&self) -> f64 {
        largest(&self.offset_ut)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.offset_ut, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(4.0, 40.0, severity);
        Self { offset_ut: (rng.direction() * size).into(), viscous: rng.between(0.02, 0.15) }
    }
}

/// Parts with the field they have soaked up.
#[derive(Debug, Clone)]
pub(crate) struct Iron {
    config: HardIron,
    decay: Decay,
    soaked: Option<Vector3<f64>>,
}

impl Iron {
    pub(crate) fn new(config: HardIron) -> Self {
        Self { config, decay: Decay::new(VISCOUS_S), soaked: None }
    }
    /// Field of the parts, µT, `dt_s` later in the outer field `outer`.
    pub(crate) fn field(&mut self, outer: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        // they have always been where they are at the start
        let before = self.soaked.unwrap_or(*outer);
        let soaked = before + (outer - before) * self.decay.share(dt_s);
        self.soaked = Some(soaked);
        let offset = Vector3::from(self.config.offset_ut);
        offset + soaked.try_normalize(1e-9).unwrap_or_default() * (self.config.viscous * offset.norm())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_fixed_to_the_body_but_for_what_soaks() {
        let mut iron = Iron::new(HardIron { offset_ut: [10.0, 0.0, 0.0], viscous: 0.1 });
        let first = iron.field(&Vector3::new(0.0, 40.0, 0.0), 0.01);
        assert!((first - Vector3::new(10.0, 1.0, 0.0)).norm() < 1e-9);
        let turned = iron.field(&Vector3::new(0.0, -40.0, 0.0), 0.01);
        assert!((turned - first).norm() < 0.01);
        for _ in 0..20_000 {
            iron.field(&Vector3::new(0.0, -40.0, 0.0), 0.01);
        }
        assert!((iron.field(&Vector3::new(0.0, -40.0, 0.0), 0.01) - Vector3::new(10.0, -1.0, 0.0)).norm() < 1e-3);
    }
}
