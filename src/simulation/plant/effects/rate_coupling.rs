//! Outside the catalogue: a moving line drags the air of the next one along while it moves.
//!
//! The three racks share a compliant frame: pushing one at speed `v` shifts the next by `c v`, smoothed over
//! 0.15 s by the frame's own spring and friction. Nothing is left at standstill.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.rate_coupling]`
    RateCoupling at "effects.outside.rate_coupling" sized by shift_s; drawn by rng, severity {
        /// Shift of the next channel per speed of this one, s. Default 0 (none); plausible ±0.03 to 0.2.
        /// A larger value swings further aside while moving.
        shift_s: f64 = 0.0, -1.0..=1.0, "tenths of a second are plausible", draw rng.sign() * rng.sized(0.06, 0.3, severity);
    }
    /// The frame with what it remembers.
    Dragging runs config {
        decay: Decay = Decay::new(FRAME_S);
        followed_mm: Vector3<f64> = Vector3::zeros();
    }
}

/// Relaxation of the frame, s.
const FRAME_S: f64 = 0.15;

impl Law for Dragging {
    fn air(&mut self, air_mm: &mut Vector3<f64>, _bellows: &BellowState, at: &Moment) {
        // `c` times the smoothed speed of the channel before
        self.followed_mm += (*air_mm - self.followed_mm) * self.decay.share(at.dt_s);
        let speed = (*air_mm - self.followed_mm) / FRAME_S;
        *air_mm += Vector3::new(speed.z, speed.x, speed.y) * self.config.shift_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shift_vanishes_at_standstill() {
        let mut d = Dragging::new(RateCoupling { shift_s: 0.1 });
        let mut step = |x_mm: f64| {
            let mut air_mm = Vector3::new(x_mm, 0.0, 0.0);
            d.air(
                &mut air_mm,
                &BellowState::default(),
                &Moment {
                    t: 0.0,
                    dt_s: 0.001,
                },
            );
            air_mm - Vector3::new(x_mm, 0.0, 0.0)
        };
        let mut shift = Vector3::zeros();
        for k in 0..1000 {
            shift = step(0.01 * f64::from(k));
        }
        assert!((shift.y - 1.0).abs() < 0.02 && shift.x == 0.0, "{shift}");
        for _ in 0..3000 {
            shift = step(9.99);
        }
        assert!(shift.norm() < 1e-3);
    }
}
