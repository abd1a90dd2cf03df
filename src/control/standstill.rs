//! The standstill latch: the pistons stop once the tip is on target.
//!
//! With backlash and a noisy estimate, a loop would move the pistons to and fro within the backlash for ever. The latch
//! closes when the smoothed error has stayed within an inner band for some time, and opens when it leaves an outer band
//! or the set-point moves. While it is closed, targets and integrator are frozen.

use crate::parameters;

parameters! {
    /// The standstill latch: the pistons stand while the error is small.
    pub struct StandstillConfig: Copy {
        /// The latch closes when the error is below this angle. A larger value stops sooner and less exactly.
        close_deg: f64 = 0.15, "deg", 0.0..=10.0, "0.15 is three times the noise of the estimate";
        /// Time for which the error must stay below `close_deg`. A larger value waits for a tip that swings through.
        close_after_s: f64 = 0.05, "s", 0.0..=5.0, "0.05 outlasts a tip that swings through";
        /// The latch opens when the error is above this angle. A larger value tolerates more creep before a correction.
        open_deg: f64 = 0.3, "deg", 0.0..=20.0, "twice close_deg";
        /// Time constant that smooths the error for the latch. A larger value ignores more noise and reacts later.
        smooth_s: f64 = 0.04, "s", 0.001..=5.0, "0.04 averages 20 samples at 500 Hz";
    }
}

/// The latch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StandstillLatch {
    smoothed: nalgebra::Vector2<f64>,
    inside_s: f64,
    /// The pistons do not move.
    pub closed: bool,
}

impl StandstillLatch {
    /// One tick with the error and the widening of both bands, rad. `moving` is true while the set-point itself moves.
    pub fn step(
        &mut self,
        config: &StandstillConfig,
        wider_rad: f64,
        error: nalgebra::Vector2<f64>,
        moving: bool,
        dt_s: f64,
    ) {
        let k = 1.0 - (-dt_s / config.smooth_s).exp();
        self.smoothed += (error - self.smoothed) * k;
        if moving {
            *self = Self {
                smoothed: error,
                ..Self::default()
            };
            return;
        }
        let size = self.smoothed.norm();
        self.inside_s = if size < config.close_deg.to_radians().max(wider_rad) {
            self.inside_s + dt_s
        } else {
            0.0
        };
        self.closed = if self.closed {
            size < config.open_deg.to_radians() + 1.5 * wider_rad
        } else {
            self.inside_s >= config.close_after_s
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// Bands of 0.002 and 0.005 rad.
    const CONFIG: StandstillConfig = StandstillConfig {
        close_deg: 0.1146,
        close_after_s: 0.05,
        open_deg: 0.2865,
        smooth_s: 0.03,
    };

    #[test]
    fn closes_inside_the_inner_band_and_opens_outside_the_outer() {
        let mut s = StandstillLatch::default();
        for _ in 0..30 {
            s.step(&CONFIG, 0.0, Vector2::new(0.001, 0.0), false, 0.001);
            assert!(!s.closed);
        }
        for _ in 0..100 {
            s.step(&CONFIG, 0.0, Vector2::new(0.001, 0.0), false, 0.001);
        }
        assert!(s.closed);
        for _ in 0..200 {
            s.step(&CONFIG, 0.0, Vector2::new(0.004, 0.0), false, 0.001);
        }
        assert!(s.closed, "between the bands the latch keeps its state");
        for _ in 0..200 {
            s.step(&CONFIG, 0.0, Vector2::new(0.006, 0.0), false, 0.001);
        }
        assert!(!s.closed);
    }

    #[test]
    fn a_moving_target_opens_it() {
        let mut s = StandstillLatch {
            closed: true,
            ..StandstillLatch::default()
        };
        s.step(&CONFIG, 0.0, Vector2::zeros(), true, 0.001);
        assert!(!s.closed);
    }
}
