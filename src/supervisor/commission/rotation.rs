//! Rotation of the tip from the gyroscope alone: q̇ = ½ q ω, with the bias measured at rest before.
//!
//! Over a few seconds the gyroscope is accurate to a tenth of a degree. It needs neither the field nor the vertical, so
//! its result does not depend on a calibrated mount. A bend R(β, δ) is a rotation by β about (sin δ, cos δ, 0), so the
//! bend vector is (w_y, w_x) of the rotation vector w.

use crate::estimation::fusion::health::ImuReading;
use crate::model::Bend;
use crate::primitives::ImuSample;
use crate::supervisor::Sensed;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// Longest gap between two samples that is integrated in full, s.
const GAP_MAX_S: f64 = 0.1;
/// Fewest samples for a bias.
const SAMPLES_MIN: u32 = 20;

/// Gyroscope bias: the mean angular rate of a tip at rest.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct GyroBias {
    sum_rad_s: Vector3<f64>,
    max_rad_s: f64,
    samples: u32,
}

impl GyroBias {
    /// Adds the sample of one cycle, if there is one.
    pub fn add(&mut self, sensed: &Sensed) {
        if let ImuReading::Sample(s, _) = &sensed.imu {
            self.sum_rad_s += s.gyro_rad_s;
            self.max_rad_s = self.max_rad_s.max(s.gyro_rad_s.norm());
            self.samples += 1;
        }
    }

    /// The bias, rad/s; `None` if there are too few samples or the tip moved.
    pub fn rad_s(&self, still_max_rad_s: f64) -> Option<Vector3<f64>> {
        let mean = self.sum_rad_s / f64::from(self.samples.max(1));
        (self.has_samples() && self.max_rad_s - mean.norm() <= still_max_rad_s).then_some(mean)
    }

    /// Number of samples.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// True if there are enough samples for a bias.
    pub fn has_samples(&self) -> bool {
        self.samples >= SAMPLES_MIN
    }
}

/// Rotation since the start.
#[derive(Debug, Clone, Copy)]
pub struct TipRotation {
    bias_rad_s: Vector3<f64>,
    r: UnitQuaternion<f64>,
    last: Option<ImuSample>,
}

impl TipRotation {
    /// The identity.
    pub fn new(bias_rad_s: Vector3<f64>) -> Self {
        Self {
            bias_rad_s,
            r: UnitQuaternion::identity(),
            last: None,
        }
    }

    /// Integrates the sample of one cycle, if there is one.
    pub fn add(&mut self, sensed: &Sensed) {
        let ImuReading::Sample(sample, _) = &sensed.imu else {
            return;
        };
        if let Some(last) = &self.last {
            let mean = 0.5 * (last.gyro_rad_s + sample.gyro_rad_s) - self.bias_rad_s;
            self.r *= UnitQuaternion::from_scaled_axis(
                mean * (sample.t.0 - last.t.0).clamp(0.0, GAP_MAX_S),
            );
        }
        self.last = Some(*sample);
    }

    /// The bend vector, rad.
    pub fn bend(&self) -> Bend {
        let w = self.r.scaled_axis();
        Bend(Vector2::new(w.y, w.x))
    }
}
