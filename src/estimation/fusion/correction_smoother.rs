//! Recovery without a jump: what a correction moves after a fault is handed out over time.
//!
//! While armed, every correction of the estimate is taken back from the output and let in with time
//! constant τ, so that what the loop feels follows the gyroscope at once and gravity smoothly.

use nalgebra::Vector2;

/// Time constant, s.
const TAU_S: f64 = 0.3;
/// How long after a recovery corrections are still handed out slowly, s.
const ARMED_S: f64 = 1.0;
/// What is left is dropped below this, rad.
const GONE_RAD: f64 = 1e-5;

/// Difference between what is felt and what the estimator says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CorrectionSmoother {
    /// Added to the estimate, rad.
    pub offset: Vector2<f64>,
    armed_s: f64,
}

impl CorrectionSmoother {
    /// From now on for a while.
    pub fn arm(&mut self) {
        self.armed_s = ARMED_S;
    }
    /// One update that moved the estimate by `jump` on top of what the gyroscope says.
    pub fn step(&mut self, jump: &Vector2<f64>, dt_s: f64) {
        if self.armed_s > 0.0 {
            self.armed_s -= dt_s;
            self.offset -= jump;
        }
        self.offset *= (-dt_s / TAU_S).exp();
        if self.offset.norm_squared() < GONE_RAD * GONE_RAD {
            self.offset = Vector2::zeros();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_spread_and_wholly_let_in() {
        let mut smoother = CorrectionSmoother::default();
        smoother.step(&Vector2::new(0.2, 0.0), 0.005);
        assert_eq!(smoother.offset, Vector2::zeros(), "corrections pass when nothing was wrong");
        smoother.arm();
        let (mut estimate, mut output) = (0.0, 0.0);
        for k in 0..1000 {
            let jump = if k == 3 { 0.2 } else { 0.0 };
            estimate += jump;
            smoother.step(&Vector2::new(jump, 0.0), 0.005);
            let now = estimate + smoother.offset.x;
            assert!((now - output).abs() < 0.2 * 0.02, "{now} after {output}");
            output = now;
        }
        assert_eq!(output, 0.2);
    }
}
