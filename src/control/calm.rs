//! Calm corrections: once the set-point has rested for a while, the pistons move slowly.
//!
//! What is left to correct then is small, and a quick correction costs more than it gains: a piston that reverses crosses a backlash
//! that is known to a few percent only, and the tip jumps by what is wrong. A piston that crosses it slowly is stopped by the feedback
//! as soon as the tip answers. A large error, which an obstruction that gives way or a disturbance leaves, is corrected faster.

/// Time for which the set-point has rested, s: the pistons of a nominal line have made their corrections.
const AFTER_S: f64 = 0.75;
/// Speed of the tip that each piston may cause, rad/s (1 °/s).
const SPEED: f64 = 0.0175;
/// Error above which the speed rises, rad (4°), and its additional speed, 1/s.
const LARGE_RAD: f64 = 0.07;
const GAIN_1_S: f64 = 10.0;

/// Time for which the set-point has rested.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CalmCorrection {
    rested_s: f64,
}

impl CalmCorrection {
    /// One tick with a set-point that moves or rests.
    pub fn step(&mut self, moving: bool, dt_s: f64) {
        self.rested_s = if moving { 0.0 } else { self.rested_s + dt_s };
    }

    /// Whether the pistons move slowly.
    pub fn is_calm(&self) -> bool {
        self.rested_s >= AFTER_S
    }

    /// Largest speed of the tip that a piston may cause at an error, rad/s; `None` while there is no bound.
    pub fn speed(&self, error_rad: f64) -> Option<f64> {
        self.is_calm().then(|| SPEED + GAIN_1_S * (error_rad - LARGE_RAD).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_point_that_has_rested_is_corrected_slowly_unless_the_error_is_large() {
        let mut calm = CalmCorrection::default();
        let rest = |calm: &mut CalmCorrection, seconds: f64| (0..(seconds * 100.0) as usize).for_each(|_| calm.step(false, 0.01));
        rest(&mut calm, 0.7);
        assert_eq!(calm.speed(0.01), None);
        rest(&mut calm, 0.1);
        assert_eq!(calm.speed(0.01), Some(SPEED));
        assert!(calm.speed(0.2).unwrap() > 1.0, "{calm:?}");
        calm.step(true, 0.01);
        assert_eq!(calm.speed(0.2), None);
    }
}
