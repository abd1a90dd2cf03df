//! The rest latch: once the tip is where it was told, nothing moves.
//!
//! A loop with play and a felt bend that has noise would push the pistons to and fro inside the
//! backlash for ever. The latch closes when the error has stayed inside an inner band for a while and
//! opens when its smoothed value leaves an outer band or a new target comes; closed, targets and
//! integrator are frozen.

/// Bands of the latch, radians and seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandstillConfig {
    /// The latch closes inside this error, rad.
    pub close_rad: f64,
    /// … after the error has stayed there this long, s.
    pub close_after_s: f64,
    /// The latch opens beyond this error, rad.
    pub open_rad: f64,
    /// Smoothing of the error that opens the latch, s.
    pub smooth_s: f64,
}

/// What the latch remembers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StandstillLatch {
    smoothed: nalgebra::Vector2<f64>,
    inside_s: f64,
    /// Closed: the pistons are left alone.
    pub closed: bool,
}

impl StandstillLatch {
    /// One tick. `moving` is true while the set-point itself moves.
    pub fn step(&mut self, config: &StandstillConfig, error: nalgebra::Vector2<f64>, moving: bool, dt_s: f64) {
        let k = 1.0 - (-dt_s / config.smooth_s).exp();
        self.smoothed += (error - self.smoothed) * k;
        if moving {
            *self = Self { smoothed: error, ..Self::default() };
            return;
        }
        let size = self.smoothed.norm();
        self.inside_s = if size < config.close_rad { self.inside_s + dt_s } else { 0.0 };
        self.closed = if self.closed { size < config.open_rad } else { self.inside_s >= config.close_after_s };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    const CONFIG: StandstillConfig = StandstillConfig { close_rad: 0.002, close_after_s: 0.05, open_rad: 0.005, smooth_s: 0.03 };

    #[test]
    fn closes_after_a_while_inside_and_opens_outside() {
        let mut s = StandstillLatch::default();
        for _ in 0..30 {
            s.step(&CONFIG, Vector2::new(0.001, 0.0), false, 0.001);
            assert!(!s.closed);
        }
        for _ in 0..100 {
            s.step(&CONFIG, Vector2::new(0.001, 0.0), false, 0.001);
        }
        assert!(s.closed);
        for _ in 0..200 {
            s.step(&CONFIG, Vector2::new(0.004, 0.0), false, 0.001);
        }
        assert!(s.closed, "between the bands it stays");
        for _ in 0..200 {
            s.step(&CONFIG, Vector2::new(0.006, 0.0), false, 0.001);
        }
        assert!(!s.closed);
    }

    #[test]
    fn a_moving_target_opens_it() {
        let mut s = StandstillLatch { closed: true, ..StandstillLatch::default() };
        s.step(&CONFIG, Vector2::zeros(), true, 0.001);
        assert!(!s.closed);
    }
}
