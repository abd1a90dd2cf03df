//! Outside the catalogue: scales that are wrong.
//!
//! Gyroscope and accelerometer axis by axis, the gyroscope's answer to plain force, and soft iron,
//! which stretches the field along one body-fixed direction.

use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::imu::feeling::GRAVITY_M_S2;
use crate::simulation::plant::plant_effect::{PlantEffect, largest, scale_all};
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.outside.gyro_scale]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GyroScale {
    /// Excess of each axis, as a share. Default 0; the data sheet allows ±0.015, plausible up to
    /// ±0.15. Bigger integrates to wronger angles.
    pub share: [f64; 3],
}

/// `[effects.outside.acc_scale]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AccScale {
    /// Excess of each axis, as a share. Default 0; the data sheet allows ±0.005, plausible up to
    /// ±0.15. Bigger tilts the vertical more between attitudes.
    pub share: [f64; 3],
}

/// `[effects.outside.soft_iron]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SoftIron {
    /// Stretch of the field along the direction, as a share. Default 0 (none); plausible ±0.05 to
    /// 0.3. Bigger turns the heading more, twice per turn.
    pub stretch: f64,
    /// Direction in the body, any length. Default [1, 0, 0].
    pub direction: [f64; 3],
}

/// `[effects.outside.g_sensitivity]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GSensitivity {
    /// Rate that each axis of the gyroscope reads under 1 g along it, °/s. Default 0; plausible ±0.1
    /// to 3. Bigger makes the bias depend on attitude.
    pub deg_s_per_g: [f64; 3],
}

impl Default for SoftIron {
    fn default() -> Self {
        Self { stretch: 0.0, direction: [1.0, 0.0, 0.0] }
    }
}

impl PlantEffect for GyroScale {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.outside.gyro_scale.share", &self.share, -0.5..=0.5, "up to ±0.15 is plausible")
    }
    fn size(&self) -> f64 {
        largest(&self.share)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.share, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(0.03, 0.15, severity);
        Self { share: std::array::from_fn(|_| size * rng.sign() * rng.between(0.6, 1.2)) }
    }
}

impl GyroScale {
    pub(crate) fn apply(&self, rate: &mut Vector3<f64>) {
        *rate += rate.component_mul(&Vector3::from(self.share));
    }
}

impl PlantEffect for AccScale {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.outside.acc_scale.share", &self.share, -0.5..=0.5, "up to ±0.15 is plausible")
    }
    fn size(&self) -> f64 {
        largest(&self.share)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.share, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(0.03, 0.15, severity);
        Self { share: std::array::from_fn(|_| size * rng.sign() * rng.between(0.6, 1.2)) }
    }
}

impl AccScale {
    pub(crate) fn apply(&self, force: &mut Vector3<f64>) {
        *force += force.component_mul(&Vector3::from(self.share));
    }
}

impl PlantEffect for SoftIron {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.soft_iron.stretch", self.stretch, -0.9..=5.0, "±0.05 to 0.3 is plausible")?;
        ranges("effects.outside.soft_iron.direction", &self.direction, -1e3..=1e3, "a direction")?;
        range("effects.outside.soft_iron.direction length", Vector3::from(self.direction).norm(), 1e-3..=1e4, "a direction has a length")
    }
    fn size(&self) -> f64 {
        self.stretch
    }
    fn scale(&mut self, factor: f64) {
        self.stretch = (self.stretch * factor).max(-0.9);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { stretch: rng.sized(0.06, 0.35, severity), direction: rng.direction().into() }
    }
}

impl SoftIron {
    pub(crate) fn apply(&self, field: &mut Vector3<f64>) {
        let along = Vector3::from(self.direction).normalize();
        *field += along * (self.stretch * along.dot(field));
    }
}

impl PlantEffect for GSensitivity {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.outside.g_sensitivity.deg_s_per_g", &self.deg_s_per_g, -50.0..=50.0, "a few °/s are plausible")
    }
    fn size(&self) -> f64 {
        largest(&self.deg_s_per_g)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.deg_s_per_g, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(0.6, 4.0, severity);
        Self { deg_s_per_g: (rng.direction() * size).into() }
    }
}

impl GSensitivity {
    /// Rate that is read for the force, rad/s.
    pub(crate) fn rate(&self, force: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from(self.deg_s_per_g).component_mul(force).map(|x| (x / GRAVITY_M_S2).to_radians())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretch_what_they_should_and_nothing_else() {
        let mut field = Vector3::new(10.0, 20.0, 0.0);
        SoftIron { stretch: 0.5, direction: [0.0, 2.0, 0.0] }.apply(&mut field);
        assert!((field - Vector3::new(10.0, 30.0, 0.0)).norm() < 1e-12);
        let mut rate = Vector3::new(1.0, -1.0, 2.0);
        GyroScale { share: [0.1, 0.0, -0.1] }.apply(&mut rate);
        assert!((rate - Vector3::new(1.1, -1.0, 1.8)).norm() < 1e-12);
        let g = GSensitivity { deg_s_per_g: [0.0, 0.0, 2.0] };
        assert!((g.rate(&Vector3::new(0.0, 0.0, GRAVITY_M_S2)).z.to_degrees() - 2.0).abs() < 1e-12);
    }
}
