//! Outside the catalogue: a moving line drags the air of the next one along while it moves.
//!
//! The three racks share a compliant frame: pushing one at speed `v` shifts the next by `c v`, smoothed over
//! 0.15 s by the frame's own spring and friction. Nothing is left at standstill.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.outside.rate_coupling]`
    RateCoupling at "effects.outside.rate_coupling" sized by shift_s {
        /// Shift of the next channel per speed of this one, s. Default 0 (none); plausible ±0.03 to 0.2.
        /// A larger value swings further aside while moving.
        shift_s: f64 = 0.0, "", -1.0..=1.0, "tenths of a second are plausible";
    }
}

impl PlantEffect for RateCoupling {
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { shift_s: rng.sign() * rng.sized(0.06, 0.3, severity) }
    }
}

/// Relaxation of the frame, s.
const FRAME_S: f64 = 0.15;

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

impl Law for Dragging {
    fn air(&mut self, air_mm: &mut Vector3<f64>, _bellows: &BellowState, at: &Moment) {
        *air_mm += self.step(air_mm, at.dt_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shift_vanishes_at_standstill() {
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
