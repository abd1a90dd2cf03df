//! The physical quantities at an inertial and magnetic sensor.

use crate::simulation::plant::memory::Mix;
use nalgebra::{UnitQuaternion, Vector3};

/// Standard gravity, rounded as everywhere in the project, m/s².
pub(crate) const GRAVITY_M_S2: f64 = 9.81;

/// Quantities at one moment, in axes that the context states.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Stimulus {
    /// Angular rate, rad/s.
    pub(crate) rate: Vector3<f64>,
    /// Specific force, m/s².
    pub(crate) force: Vector3<f64>,
    /// Magnetic field, µT.
    pub(crate) field: Vector3<f64>,
}

impl Stimulus {
    /// The same in axes that are turned by `r`.
    pub(crate) fn turned_by(&self, r: &UnitQuaternion<f64>) -> Self {
        Self {
            rate: r.inverse_transform_vector(&self.rate),
            force: r.inverse_transform_vector(&self.force),
            field: r.inverse_transform_vector(&self.field),
        }
    }
}

impl Mix for Stimulus {
    fn mix(&self, other: &Self, share: f64) -> Self {
        Self {
            rate: self.rate.lerp(&other.rate, share),
            force: self.force.lerp(&other.force, share),
            field: self.field.lerp(&other.field, share),
        }
    }
}
