//! Recovery without a jump: applies the corrections after a fault over time.
//!
//! While armed, every correction of the estimate is subtracted from the output and then decays with time constant τ.
//! The output follows the gyroscope at once, and gravity and field smoothly.

use nalgebra::Vector2;

crate::constants! {
    /// How corrections are smoothed.
    const SMOOTH: SmoothConstants;
    /// Time constant, s.
    tau_s = 0.3;
    /// Time after a recovery during which corrections are smoothed, s.
    armed_s = 1.0;
    /// Offset that is set to zero, rad: far below the resolution of the estimate.
    negligible_rad = 1e-5;
}

/// Difference between the output and the estimate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CorrectionSmoother {
    /// Added to the estimate, rad.
    pub offset: Vector2<f64>,
    armed_s: f64,
}

impl CorrectionSmoother {
    /// Smooths the corrections of the next second.
    pub fn arm(&mut self) {
        self.armed_s = SMOOTH.armed_s;
    }
    /// Processes an update that moved the estimate by `correction` beyond the integrated rate.
    pub fn step(&mut self, correction: &Vector2<f64>, dt_s: f64) {
        if self.armed_s > 0.0 {
            self.armed_s -= dt_s;
            self.offset -= correction;
        }
        self.offset *= (-dt_s / SMOOTH.tau_s).exp();
        if self.offset.norm_squared() < SMOOTH.negligible_rad * SMOOTH.negligible_rad {
            self.offset = Vector2::zeros();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_correction_is_spread_and_applied_in_full() {
        let mut smoother = CorrectionSmoother::default();
        smoother.step(&Vector2::new(0.2, 0.0), 0.005);
        assert_eq!(
            smoother.offset,
            Vector2::zeros(),
            "corrections pass unsmoothed while unarmed"
        );
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
