//! A chip that sits askew in the tip, on a board that gives under its own weight.
//!
//! Rotation vector `m + w (f/g) × ẑ`: a constant tilt, and `w` of bending per g across.

use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::imu::feeling::GRAVITY_M_S2;
use crate::simulation::plant::plant_effect::{PlantEffect, largest, scale_all};
use crate::simulation::plant::rng::PlantRng;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// `[effects.mount_misalignment]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountMisalignment {
    /// Tilt m of the chip in the tip, a rotation vector in degrees. Default 0 (none); typical 1 to
    /// 15. Bigger mixes the axes more.
    pub tilt_deg: [f64; 3],
    /// Give w of the board, as a share of the tilt's angle per g. Default 0.03. Bigger depends more
    /// on attitude.
    pub give: f64,
}

impl Default for MountMisalignment {
    fn default() -> Self {
        Self { tilt_deg: [0.0; 3], give: 0.03 }
    }
}

impl PlantEffect for MountMisalignment {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.mount_misalignment.tilt_deg", &self.tilt_deg, -180.0..=180.0, "1 to 15 is typical")?;
        range("effects.mount_misalignment.give", self.give, 0.0..=0.5, "0.03 is typical")
    }
    fn size(&self) -> f64 {
        largest(&self.tilt_deg)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.tilt_deg, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(3.0, 15.0, severity);
        Self { tilt_deg: (rng.direction() * size).into(), give: rng.between(0.0, 0.05) }
    }
}

impl MountMisalignment {
    /// Chip to tip, under the specific force `force` (m/s²).
    pub(crate) fn turn(&self, force: &Vector3<f64>) -> UnitQuaternion<f64> {
        let tilt = Vector3::from(self.tilt_deg).map(f64::to_radians);
        let give = force.cross(&Vector3::z()) * (self.give * tilt.norm() / GRAVITY_M_S2);
        UnitQuaternion::from_scaled_axis(tilt + give)
    }
}
