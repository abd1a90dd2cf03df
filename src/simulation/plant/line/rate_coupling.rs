//! Outside the catalogue: a line that moves drags the air of the next one along, while it moves.
//!
//! The three racks share a frame that gives: pushing one at speed `v` shifts the next by `c v`, seen
//! through 0.15 s of the frame's own spring and friction. Nothing is left once all stand still.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::memory::Decay;
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.outside.rate_coupling]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RateCoupling {
    /// Shift of the next channel per speed of this one, s. Default 0 (none); plausible ±0.03 to 0.2.
    /// Bigger swings further aside while moving.
    pub shift_s: f64,
}

/// Relaxation of the frame, s.
const FRAME_S: f64 = 0.15;

impl PlantEffect for RateCoupling {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.rate_coupling.shift_s", self.shift_s, -1.0..=1.0, "tenths of a second are plausible")
    }
    fn size(&self) -> f64 {
        self.shift_s
    }
    fn scale(&mut self, factor: f64) {
        self.shift_s *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { shift_s: rng.sign() * rng.sized(0.06, 0.3, severity) }
    }
}

/// The frame with what it remembers.
#[derive(Debug, Clone)]
pub(crate) struct Dragging {
    config: RateCoupling,
    decay: Decay,
    followed_mm: Vector3<f64>,
}

impl Dragging {
    pub(crate) fn new(config: RateCoupling) -> Self {
        Self { config, decay: Decay::new(FRAME_S), followed_mm: Vector3::zeros() }
    }
    /// Shift of each line, mm of piston: `c` times the smoothed speed of the channel before.
    pub(crate) fn step(&mut self, play_output_mm: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        self.followed_mm += (play_output_mm - self.followed_mm) * self.decay.share(dt_s);
        let speed = (play_output_mm - self.followed_mm) / FRAME_S;
        Vector3::new(speed.z, speed.x, speed.y) * self.config.shift_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn acts_while_moving_and_vanishes_at_rest() {
        let mut d = Dragging::new(RateCoupling { shift_s: 0.1 });
        let mut shift = Vector3::zeros();
        for k in 0..1000 {
            shift = d.step(&Vector3::new(0.01 * f64::from(k), 0.0, 0.0), 0.001);
        }
        assert!((shift.y - 1.0).abs() < 0.02 && shift.x == 0.0, "{shift}");
        for _ in 0..3000 {
            shift = d.step(&Vector3::new(9.99, 0.0, 0.0), 0.001);
        }
        assert!(shift.norm() < 1e-3);
    }
}
