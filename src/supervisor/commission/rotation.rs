//! Rotation of the tip from the gyroscope alone: q̇ = ½ q ω, with the bias measured at rest before.
//!
//! Over a few seconds the gyroscope is accurate to a tenth of a degree. It needs neither the field nor the vertical, so
//! its result does not depend on a calibrated mount. A bend R(β, δ) is a rotation by β about (sin δ, cos δ, 0), so the
//! bend vector is (w_y, w_x) of the rotation vector w.

use crate::model::Bend;
use crate::primitives::{ImuReading, ImuSample};
use crate::supervisor::Sensed;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// Longest gap between two samples that is integrated in full, s.
const GAP_MAX_S: f64 = 0.1;

/// What the gyroscope says of a tip: its mean rate, and its rotation from the first sample on, less the bias.
#[derive(Debug, Clone, Copy, Default)]
pub struct TipRotation {
    bias_rad_s: Vector3<f64>,
    r: UnitQuaternion<f64>,
    last: Option<ImuSample>,
    sum_rad_s: Vector3<f64>,
    /// Largest rate of a sample, rad/s.
    pub max_rad_s: f64,
    /// Number of samples.
    pub samples: u32,
}

impl TipRotation {
    /// No rotation, of a gyroscope with this bias.
    pub fn new(bias_rad_s: Vector3<f64>) -> Self {
        Self {
            bias_rad_s,
            ..Self::default()
        }
    }

    /// Takes the sample of one cycle, if there is one.
    pub fn add(&mut self, sensed: &Sensed) {
        let ImuReading::Sample(sample, _) = &sensed.imu else {
            return;
        };
        self.sum_rad_s += sample.gyro_rad_s;
        self.max_rad_s = self.max_rad_s.max(sample.gyro_rad_s.norm());
        self.samples += 1;
        if let Some(last) = self.last.replace(*sample) {
            let mean = 0.5 * (last.gyro_rad_s + sample.gyro_rad_s) - self.bias_rad_s;
            let took_s = (sample.t.0 - last.t.0).clamp(0.0, GAP_MAX_S);
            self.r *= UnitQuaternion::from_scaled_axis(mean * took_s);
        }
    }

    /// Mean rate of all samples, rad/s: the bias, if the tip rests.
    pub fn mean_rad_s(&self) -> Vector3<f64> {
        self.sum_rad_s / f64::from(self.samples.max(1))
    }

    /// The bend vector, rad.
    pub fn bend(&self) -> Bend {
        let w = self.r.scaled_axis();
        Bend(Vector2::new(w.y, w.x))
    }
}
