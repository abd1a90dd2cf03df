//! Calm corrections: once the set-point has rested for a while, the pistons move slowly.
//!
//! What is left to correct then is small, and a quick correction costs more than it gains: a piston that reverses crosses a backlash
//! that is known to a few percent only, and the tip jumps by what is wrong. A piston that crosses it slowly is stopped by the feedback
//! as soon as the tip answers. A large error, which an obstruction that gives way or a disturbance leaves, is corrected faster.

use crate::parameters;

parameters! {
    /// Slow corrections of a set-point that rests.
    pub struct CalmConfig: Copy {
        /// Time after which a set-point that rests is corrected slowly. A larger value corrects quickly for longer, and more poses are
        /// left by the jump of a late reversal.
        after_s: f64 = 0.75, "s", 0.0..=60.0, "0.75 lets a nominal line make its corrections";
        /// Speed of the tip that each piston may then cause. A larger value corrects sooner and jumps further.
        speed_deg_s: f64 = 1.0, "deg/s", 0.01..=1000.0, "1 moves the tip by 0.1° before a line with 0.1 s of lag answers";
        /// Error above which that speed rises. A larger value corrects disturbances more slowly.
        large_deg: f64 = 4.0, "deg", 0.0..=180.0, "4 is more than a learned pose leaves";
    }
}

/// Additional speed for an error above the large one, 1/s.
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
    pub fn is_calm(&self, config: &CalmConfig) -> bool {
        self.rested_s >= config.after_s
    }

    /// Largest speed of the tip that a piston may cause at an error, rad/s; `None` while there is no bound.
    pub fn speed(&self, config: &CalmConfig, error_rad: f64) -> Option<f64> {
        let beyond_rad = (error_rad - config.large_deg.to_radians()).max(0.0);
        self.is_calm(config)
            .then(|| config.speed_deg_s.to_radians() + GAIN_1_S * beyond_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_point_that_has_rested_is_corrected_slowly_unless_the_error_is_large() {
        let (config, mut calm) = (CalmConfig::default(), CalmCorrection::default());
        let rest = |calm: &mut CalmCorrection, seconds: f64| {
            (0..(seconds * 100.0) as usize).for_each(|_| calm.step(false, 0.01))
        };
        rest(&mut calm, 0.7);
        assert_eq!(calm.speed(&config, 0.01), None);
        rest(&mut calm, 0.1);
        assert_eq!(calm.speed(&config, 0.01), Some(1f64.to_radians()));
        assert!(calm.speed(&config, 0.2).unwrap() > 1.0, "{calm:?}");
        calm.step(true, 0.01);
        assert_eq!(calm.speed(&config, 0.2), None);
    }
}
