//! Rack and pinion: piston displacement in mm and microsteps of the motor.
//!
//! One turn of the pinion moves the rack by π times its pitch diameter. The paper's 200-step motor,
//! 16 microsteps and 30 mm pinion give 0.02945 mm a microstep (the paper prints 0.0294).

use crate::primitives::Steps;
use nalgebra::Vector3;

/// The drive train of one channel; all three are alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
}

impl Default for Drive {
    fn default() -> Self {
        Self::rack_and_pinion(30.0, 200, 16)
    }
}

impl Drive {
    /// From the pinion's pitch diameter, the motor's full steps a turn and the microstep divider.
    pub fn rack_and_pinion(pitch_diameter_mm: f64, full_steps: u32, microsteps: u32) -> Self {
        Self {
            step_mm: std::f64::consts::PI * pitch_diameter_mm / f64::from(full_steps * microsteps),
        }
    }
    /// The microstep counts nearest to piston displacements in mm.
    pub fn steps(&self, piston_mm: &Vector3<f64>) -> Steps {
        Steps(std::array::from_fn(|i| {
            (piston_mm[i] / self.step_mm).round() as i32
        }))
    }
    /// Piston displacement in mm of microstep counts.
    pub fn piston_mm(&self, steps: &Steps) -> Vector3<f64> {
        Vector3::from_fn(|i, _| f64::from(steps.0[i]) * self.step_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_resolution() {
        assert!((Drive::default().step_mm - 0.029_452).abs() < 1e-6);
    }

    #[test]
    fn every_count_round_trips() {
        let d = Drive::default();
        for n in -1200..1200 {
            let s = Steps([n, -n, n / 2]);
            assert_eq!(d.steps(&d.piston_mm(&s)), s);
        }
    }
}
