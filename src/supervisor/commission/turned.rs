//! Rotation of the tip since a moment, by the gyroscope alone: q̇ = ½ q ω, bias taken at rest before.
//!
//! Over some seconds the gyroscope is good to a tenth of a degree and needs neither field nor vertical,
//! so it can tell a wrong mount from a wrong wire. A bend R(β, δ) is a rotation by β about
//! (sin δ, cos δ, 0), so the bend vector is (w_y, w_x) of the rotation vector w.

use crate::estimation::fusion::health::ImuReading;
use crate::model::bend::Bend;
use crate::primitives::sample::ImuSample;
use crate::supervisor::machine::Sensed;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// A sample further from the last than this does not belong to the same motion, s.
const GAP_MAX_S: f64 = 0.1;

/// Mean angular rate of a still stretch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Rest {
    sum_rad_s: Vector3<f64>,
    most_rad_s: f64,
    samples: u32,
}

impl Rest {
    /// Takes in one turn.
    pub fn see(&mut self, sensed: &Sensed) {
        if let ImuReading::Sample(s, _) = &sensed.imu {
            self.sum_rad_s += s.gyro_rad_s;
            self.most_rad_s = self.most_rad_s.max(s.gyro_rad_s.norm());
            self.samples += 1;
        }
    }

    /// The bias, rad/s; `None` without samples, or when the tip moved.
    #[must_use]
    pub fn bias_rad_s(&self, still_max_rad_s: f64) -> Option<Vector3<f64>> {
        let mean = self.sum_rad_s / f64::from(self.samples.max(1));
        (self.samples >= 20 && self.most_rad_s - mean.norm() <= still_max_rad_s).then_some(mean)
    }

    /// Samples seen.
    #[must_use]
    pub fn samples(&self) -> u32 {
        self.samples
    }
}

/// Rotation since the start.
#[derive(Debug, Clone, Copy)]
pub struct Turned {
    bias_rad_s: Vector3<f64>,
    r: UnitQuaternion<f64>,
    last: Option<ImuSample>,
    lost: u32,
}

impl Turned {
    /// Not turned yet.
    #[must_use]
    pub fn new(bias_rad_s: Vector3<f64>) -> Self {
        Self { bias_rad_s, r: UnitQuaternion::identity(), last: None, lost: 0 }
    }

    /// Takes in one turn.
    pub fn see(&mut self, sensed: &Sensed) {
        let ImuReading::Sample(sample, _) = &sensed.imu else { return };
        if let Some(last) = &self.last {
            let dt_s = sample.t.0 - last.t.0;
            if dt_s > GAP_MAX_S {
                self.lost += 1;
            }
            let mean = 0.5 * (last.gyro_rad_s + sample.gyro_rad_s) - self.bias_rad_s;
            self.r *= UnitQuaternion::from_scaled_axis(mean * dt_s.clamp(0.0, GAP_MAX_S));
        }
        self.last = Some(*sample);
    }

    /// The bend vector, rad.
    #[must_use]
    pub fn bend(&self) -> Bend {
        let w = self.r.scaled_axis();
        Bend(Vector2::new(w.y, w.x))
    }

    /// Holes in the data that were too long to bridge.
    #[must_use]
    pub fn lost(&self) -> u32 {
        self.lost
    }
}
