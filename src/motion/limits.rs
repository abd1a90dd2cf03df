//! The motion limits of a channel, and the tolerances of every comparison with them.
//!
//! All channels share one set of limits because the drives are alike. Comparisons allow a relative
//! tolerance of [`TOLERANCE`] for rounding in a chain of cubics, a thousandth of the 1e-6 that
//! [`crate::motion`] guarantees.

use crate::motion::{MotionConfig, MotionState};
use crate::primitives::{Checker, Invalid, Parameters};

/// Relative tolerance of every comparison with a limit.
pub const TOLERANCE: f64 = 1e-9;
/// Tolerance of a comparison of positions, mm. The planner closes its position equation to 1e-8 mm.
pub const POSITION_TOLERANCE_MM: f64 = 1e-7;

/// Limits of motion of one channel, from a valid [`MotionConfig`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionLimits {
    /// Largest speed, mm/s.
    pub speed_max_mm_s: f64,
    /// Largest acceleration of either sign, mm/s².
    pub acceleration_max_mm_s2: f64,
    /// Largest jerk of either sign, mm/s³.
    pub jerk_max_mm_s3: f64,
    /// Travel either side of rest, mm.
    pub travel_max_mm: f64,
    /// Targets nearer than this to the planned one count as the same target, mm.
    pub retarget_min_mm: f64,
}

impl TryFrom<&MotionConfig> for MotionLimits {
    type Error = Invalid;

    fn try_from(c: &MotionConfig) -> Result<Self, Invalid> {
        c.checked("motion")?;
        let mut checker = Checker::default();
        checker
            .at("limits.travel_mm")
            .range(c.travel_max_mm, 0.1..=1000.0, "mm")
            .hint("what rack and syringe allow either side of rest");
        checker.done()?;
        Ok(Self::of_checked(c))
    }
}

impl MotionLimits {
    /// The limits of a configuration that is valid, as that of every board is once it has been read.
    pub fn of_checked(c: &MotionConfig) -> Self {
        Self {
            speed_max_mm_s: c.speed_max_mm_s,
            acceleration_max_mm_s2: c.acceleration_max_mm_s2,
            jerk_max_mm_s3: c.jerk_max_mm_s3,
            travel_max_mm: c.travel_max_mm,
            retarget_min_mm: c.retarget_min_mm,
        }
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
