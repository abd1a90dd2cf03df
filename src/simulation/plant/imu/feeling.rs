//! What there is to feel for an inertial and magnetic sensor.

use crate::simulation::plant::memory::Mix;
use nalgebra::{UnitQuaternion, Vector3};

/// Standard gravity as the contract rounds it, m/s².
pub(crate) const GRAVITY_M_S2: f64 = 9.81;

/// What there is to feel at one moment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Feeling {
    /// Angular rate, rad/s.
    pub(crate) rate: Vector3<f64>,
    /// Specific force, m/s².
    pub(crate) force: Vector3<f64>,
    /// Magnetic field, µT.
    pub(crate) field: Vector3<f64>,
}

impl Feeling {
    /// The same in axes that are turned by `r`.
    pub(crate) fn turned_by(&self, r: &UnitQuaternion<f64>) -> Self {
        Self {
            rate: r.inverse_transform_vector(&self.rate),
            force: r.inverse_transform_vector(&self.force),
            field: r.inverse_transform_vector(&self.field),
        }
    }
}

impl Mix for Feeling {
    fn mix(&self, other: &Self, share: f64) -> Self {
        Self {
            rate: self.rate.lerp(&other.rate, share),
            force: self.force.lerp(&other.force, share),
            field: self.field.lerp(&other.field, share),
        }
    }
}
