//! The motion limits of a channel, and the tolerances of every comparison with them.
//!
//! All channels share one set of limits because the drives are alike. Comparisons allow a relative
//! tolerance of [`TOLERANCE`] for rounding in a chain of cubics, a thousandth of the 1e-6 that
//! [`crate::motion`] guarantees.

use crate::motion::MotionState;
use crate::parameters;
use crate::primitives::{Checker, Invalid, Parameters};

/// Relative tolerance of every comparison with a limit.
pub const TOLERANCE: f64 = 1e-9;
/// Tolerance of a comparison of positions, mm. The planner closes its position equation to 1e-8 mm.
pub const POSITION_TOLERANCE_MM: f64 = 1e-7;

parameters! {
    /// Limits of motion of the pistons: one set for all three channels.
    pub struct MotionLimits: Copy {
        /// Largest piston speed; the default is about 1,000 microsteps a second. A larger value settles sooner, until the
        /// motor loses steps.
        speed_max_mm_s: f64 = 30.0, "mm/s", 0.01..=1000.0, "30 is the paper's motor at about 1,000 microsteps a second";
        /// Largest piston acceleration. A larger value crosses the backlash sooner, until the motor loses steps.
        acceleration_max_mm_s2: f64 = 600.0, "mm/s²", 0.1..=100_000.0, "600 is gentle on a small stepper";
        /// Largest change of the acceleration; the default reaches full acceleration after 20 ms. A larger value responds
        /// faster; a smaller one shakes rack, tube and tip less.
        jerk_max_mm_s3: f64 = 30_000.0, "mm/s³", 1.0..=10_000_000.0, "fifty times the acceleration reaches it within 20 ms";
        /// A target nearer than this to the present target counts as the same. A larger value plans less often and leaves the
        /// piston that much beside the last target; 0 follows every change.
        retarget_min_mm: f64 = 0.0, "mm", 0.0..=1.0, "leave it out to follow every change";
    }
    set in code {
        /// Travel either side of rest, mm: `limits.travel_mm`. Targets beyond it are clamped; no motion, braking included,
        /// goes beyond.
        travel_max_mm: f64 = 30.0;
    }
}

impl MotionLimits {
    /// Checks every range.
    ///
    /// # Errors
    /// The first value that is refused.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.checked("motion")?;
        let mut checker = Checker::default();
        checker
            .at("limits.travel_mm")
            .range(self.travel_max_mm, 0.1..=1000.0, "mm")
            .hint("what rack and syringe allow either side of rest");
        checker.done()
    }

    /// Whether a position is within travel.
    pub fn contains_position(&self, position_mm: f64) -> bool {
        position_mm.abs() <= self.travel_max_mm + POSITION_TOLERANCE_MM
    }

    /// Whether the speed and acceleration of a state are within their limits.
    pub fn contains_rates(&self, s: &MotionState) -> bool {
        s.velocity_mm_s.abs() <= self.speed_max_mm_s * (1.0 + TOLERANCE)
            && s.acceleration_mm_s2.abs() <= self.acceleration_max_mm_s2 * (1.0 + TOLERANCE)
    }
}
