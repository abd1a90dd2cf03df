//! An accelerometer that reads an offset, a little more of it the harder the axis is loaded.
//!
//! `f + b (1 + 0.15 (f/g)²)`, axis by axis.

use crate::simulation::plant::check::{PlantError, ranges};
use crate::simulation::plant::imu::feeling::GRAVITY_M_S2;
use crate::simulation::plant::plant_effect::{PlantEffect, largest, scale_all};
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.accel_bias]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AccelBias {
    /// Offset b of each axis, mg. Default 0 (none); typical 10 to 100. 17 mg tilt the vertical by 1°.
    pub bias_mg: [f64; 3],
}

/// How much more of it at 1 g.
const LOADED: f64 = 0.15;

impl PlantEffect for AccelBias {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.accel_bias.bias_mg", &self.bias_mg, -500.0..=500.0, "10 to 100 mg is typical")
    }
    fn size(&self) -> f64 {
        largest(&self.bias_mg)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.bias_mg, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(25.0, 120.0, severity);
        Self { bias_mg: (rng.direction() * size).into() }
    }
}

impl AccelBias {
    /// What is added to the force, m/s².
    pub(crate) fn force(&self, force: &Vector3<f64>) -> Vector3<f64> {
        let loaded = force.map(|f| 1e-3 * GRAVITY_M_S2 * (1.0 + LOADED * (f / GRAVITY_M_S2).powi(2)));
        Vector3::from(self.bias_mg).component_mul(&loaded)
    }
}
