//! The distance between set-point and estimate, and how long it has been too large.

use super::limits::GateLimits;
use crate::primitives::lasting;

/// Set-point and estimated bend vector, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Following {
    /// Set-point.
    pub setpoint: [f64; 2],
    /// Estimated bend.
    pub estimate: [f64; 2],
}

/// How well the tip follows its set-point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct FollowingError {
    setpoint: Option<[f64; 2]>,
    /// Largest recent speed of the set-point, decaying, rad/s.
    recent_rad_s: f64,
    /// How long the error has been larger than the set-point speed explains, s.
    pub(super) exceeded_s: f64,
}

impl FollowingError {
    /// One tick of `dt_s`.
    pub(super) fn step(&mut self, limits: &GateLimits, following: Option<Following>, dt_s: f64) {
        let Some(Following { setpoint, estimate }) = following else {
            *self = Self::default();
            return;
        };
        let from = self.setpoint.replace(setpoint).unwrap_or(setpoint);
        let speed = distance(&setpoint, &from) / dt_s;
        self.recent_rad_s = speed.max(self.recent_rad_s * (-dt_s / limits.following_s).exp());
        let allowed = limits.following_rad + limits.following_s * self.recent_rad_s;
        // NaN does not follow
        let follows = distance(&setpoint, &estimate) <= allowed;
        self.exceeded_s = lasting(!follows, self.exceeded_s, dt_s);
    }
}

fn distance(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
