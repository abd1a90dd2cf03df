//! The machine that a diagnosis describes: gains, lag, effects with their parameters, and what its sensor reads at rest.

use crate::model::effects::{Effect, Memory, Pose};
use crate::model::{Chain, Geometry, NOMINAL, places};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;
use std::sync::Arc;

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
#[derive(Clone)]
pub struct DescribedMachine {
    /// Geometry of the bending section.
    pub geometry: Geometry,
    /// Readings at rest.
    pub rest: RestReadings,
    effects: Vec<Arc<dyn Effect>>,
    at: Vec<usize>,
    theta: Vec<f64>,
}

impl DescribedMachine {
    /// A machine with these nominal parameters (see [`crate::model::chain::nominal_theta`]) and effects with parameters.
    pub fn new(
        geometry: Geometry,
        rest: RestReadings,
        nominal: &[f64],
        causes: Vec<(Box<dyn Effect>, Vec<f64>)>,
    ) -> Self {
        let (mut effects, mut theta) = (Vec::<Arc<dyn Effect>>::new(), nominal[..NOMINAL].to_vec());
        for (effect, params) in causes {
            theta.extend(&params);
            effects.push(effect.into());
        }
        Self {
            geometry,
            rest,
            at: places(&effects),
            effects,
            theta,
        }
    }

    /// Play outputs of nominal bellow lengths, both mm.
    pub fn play_outputs(&self, bellow_mm: &Vector3<f64>) -> Vector3<f64> {
        let lines = self.chain().lines;
        Vector3::from_fn(|i, _| lines[i].play_output_mm(bellow_mm[i]))
    }

    /// The machine without the effects that happen once: they cannot be predicted.
    #[must_use]
    pub fn foreseeable(mut self) -> Self {
        let kept = |e: &Arc<dyn Effect>| !e.info().is_event();
        let mut theta = self.theta[..NOMINAL].to_vec();
        for ((_, p), e) in self.chain().each().zip(&self.effects) {
            if kept(e) {
                theta.extend(p);
            }
        }
        self.effects.retain(kept);
        (self.at, self.theta) = (places(&self.effects), theta);
        self
    }

    /// Names of the effects.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.effects.iter().map(|e| e.name())
    }

    /// The laws from pistons to shape.
    pub fn chain(&self) -> Chain<'_, Arc<dyn Effect>> {
        Chain::new(self.geometry, &self.effects, &self.at, &self.theta)
    }

    /// Nominal mechanical lag τ₀, s.
    pub fn lag_s(&self) -> f64 {
        self.theta[NOMINAL - 1]
    }

    /// State of the effects at rest.
    pub fn memory(&self) -> Vec<Memory> {
        vec![Memory::default(); self.effects.len()]
    }
}

impl PartialEq for DescribedMachine {
    fn eq(&self, other: &Self) -> bool {
        (self.geometry, self.rest, &self.theta) == (other.geometry, other.rest, &other.theta)
            && self.names().eq(other.names())
    }
}

impl fmt::Debug for DescribedMachine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.names().collect();
        f.debug_struct("DescribedMachine")
            .field("effects", &names)
            .field("theta", &self.theta)
            .finish_non_exhaustive()
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
