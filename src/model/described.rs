//! The machine that a diagnosis describes: gains, lag, effects with their parameters, and what its sensor reads at rest.

use crate::model::effects::{Effect, Memory, Pose};
use crate::model::{Chain, Geometry, Model, NOMINAL};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Deserializer, Serialize};

/// What the tip IMU reads at the initial rest, in the base frame, and the constant bias of its gyroscope.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestReadings {
    /// Direction of up, unit vector.
    #[serde(deserialize_with = "three_values")]
    pub up: Vector3<f64>,
    /// Magnetic field, µT; zero without a magnetometer.
    #[serde(deserialize_with = "three_values")]
    pub field_ut: Vector3<f64>,
    /// Bias of the gyroscope, rad/s.
    #[serde(deserialize_with = "three_values")]
    pub gyro_bias_rad_s: Vector3<f64>,
}

/// A vector as an array of three, whose error says so.
fn three_values<'de, D: Deserializer<'de>>(from: D) -> Result<Vector3<f64>, D::Error> {
    <[f64; 3]>::deserialize(from).map(Vector3::from)
}

impl Default for RestReadings {
    /// An upright base in a field of central Europe.
    fn default() -> Self {
        Self {
            up: Vector3::z(),
            field_ut: Vector3::new(20.0, 0.0, -43.0),
            gyro_bias_rad_s: Vector3::zeros(),
        }
    }
}

/// A machine as a diagnosis describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct DescribedMachine {
    /// Geometry of the bending section.
    pub geometry: Geometry,
    /// Readings at rest.
    pub rest: RestReadings,
    model: Model,
    theta: Vec<f64>,
}

impl DescribedMachine {
    /// A machine with these nominal parameters (see [`crate::model::nominal_theta`]) and effects with parameters.
    pub fn new(
        geometry: Geometry,
        rest: RestReadings,
        nominal: &[f64],
        causes: Vec<(&'static dyn Effect, Vec<f64>)>,
    ) -> Self {
        let (effects, params): (Vec<_>, Vec<_>) = causes.into_iter().unzip();
        Self {
            geometry,
            rest,
            model: Model::new(&effects),
            theta: [&nominal[..NOMINAL], &params.concat()].concat(),
        }
    }

    /// Play outputs of nominal bellow lengths, both mm.
    pub fn play_outputs(&self, bellow_mm: &Vector3<f64>) -> Vector3<f64> {
        let lines = self.chain().lines;
        Vector3::from_fn(|i, _| lines[i].play_output_mm(bellow_mm[i]))
    }

    /// The machine without the effects that happen once: they cannot be predicted.
    #[must_use]
    pub fn foreseeable(self) -> Self {
        let mut kept = self.model.effects.clone();
        kept.retain(|e| !e.info().is_event());
        let model = Model::new(&kept);
        let theta = model.extended(&self.model, &self.theta, |_| vec![]);
        Self {
            model,
            theta,
            ..self
        }
    }

    /// Names of the effects.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.model.effects.iter().map(|e| e.name())
    }

    /// The laws from pistons to shape.
    pub fn chain(&self) -> Chain<'_> {
        Chain::new(self.geometry, &self.model, &self.theta)
    }

    /// Nominal mechanical lag τ₀, s.
    pub fn lag_s(&self) -> f64 {
        self.theta[NOMINAL - 1]
    }

    /// State of the effects at rest.
    pub fn memory(&self) -> Vec<Memory> {
        vec![Memory::default(); self.model.effects.len()]
    }
}

/// Tip orientation of a pose, tip → base.
pub fn orientation(pose: &Pose) -> UnitQuaternion<f64> {
    let bent = UnitQuaternion::from_scaled_axis(Vector3::new(pose.bend.y, pose.bend.x, 0.0));
    if pose.twist == 0.0 {
        bent
    } else {
        bent * UnitQuaternion::from_scaled_axis(Vector3::z() * pose.twist)
    }
}
