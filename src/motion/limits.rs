//! The four limits of a channel, validated, and what "within" means.
//!
//! All channels share one set of limits: the drives are alike. Comparisons allow [`SLACK`] of the
//! limit for the rounding of a chain of cubics, a thousand times less than what is promised outside.

use crate::motion::config::{ConfigError, MotionConfig};
use crate::motion::state::MotionState;
use crate::motion::stop::Stop;

/// Relative slack of every comparison with a limit.
pub const SLACK: f64 = 1e-9;

/// Slack of a comparison of positions, mm: the planner closes its position equation to 1e-8 mm.
pub const POSITION_SLACK_MM: f64 = 1e-7;

/// Limits of motion of one channel; built only from a valid [`MotionConfig`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// Greatest speed, mm/s.
    pub speed_max_mm_s: f64,
    /// Greatest acceleration either way, mm/s².
    pub acceleration_max_mm_s2: f64,
    /// Greatest jerk either way, mm/s³.
    pub jerk_max_mm_s3: f64,
    /// Travel either side of rest, mm.
    pub travel_max_mm: f64,
    /// Targets nearer than this to the planned one are the same target, mm.
    pub retarget_min_mm: f64,
}

impl TryFrom<&MotionConfig> for MotionLimits {
    type Error = ConfigError;

    fn try_from(c: &MotionConfig) -> Result<Self, ConfigError> {
        c.validate()?;
        Ok(Self {
            speed_max_mm_s: c.speed_max_mm_s,
            acceleration_max_mm_s2: c.acceleration_max_mm_s2,
            jerk_max_mm_s3: c.jerk_max_mm_s3,
            travel_max_mm: c.travel_max_mm,
            retarget_min_mm: c.retarget_min_mm,
        })
    }
}

impl MotionLimits {
    /// Whether a position is within travel.
    #[inline]
    #[must_use]
    pub fn travel_holds(&self, position_mm: f64) -> bool {
        position_mm.abs() <= self.travel_max_mm + POSITION_SLACK_MM
    }

    /// Whether speed and acceleration of a state are within their limits.
    #[inline]
    #[must_use]
    pub fn rates_hold(&self, s: &MotionState) -> bool {
        s.velocity_mm_s.abs() <= self.speed_max_mm_s * (1.0 + SLACK)
            && s.acceleration_mm_s2.abs() <= self.acceleration_max_mm_s2 * (1.0 + SLACK)
    }

    /// No stop from within the limits is longer than this, mm: stopping distance grows with speed
    /// and with acceleration, so it is the one from both at their limits.
    #[must_use]
    pub fn stop_longest_mm(&self) -> f64 {
        let worst = MotionState { position_mm: 0.0, velocity_mm_s: self.speed_max_mm_s, acceleration_mm_s2: self.acceleration_max_mm_s2 };
        Stop::from(worst, self).end_mm
    }
}
