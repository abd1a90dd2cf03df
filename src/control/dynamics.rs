//! Lag and dead time from the pistons to the estimated bend.

use crate::primitives::SURE_SIGMAS;

/// Lag and dead time from the pistons to the estimated bend.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Dynamics {
    /// First-order lag τ, s.
    pub lag_s: f64,
    /// Dead time T, s.
    pub delay_s: f64,
}

impl Dynamics {
    /// Lag plus dead time, s: the mean delay of the answer to a step.
    pub fn response_s(&self) -> f64 {
        self.lag_s + self.delay_s
    }
}

/// Lag and dead time before any motion, and how far they may be off.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DynamicsPrior {
    /// Expected values.
    pub expected: Dynamics,
    /// Standard deviation of lag and of dead time, s.
    pub uncertainty_s: f64,
}

/// Lags and dead times that a line or a sensor can have, s: the longest is beyond any of them.
const TIMES_S: std::ops::RangeInclusive<f64> = 0.0..=600.0;

impl DynamicsPrior {
    /// True for a lag or a dead time that something can have.
    pub fn is_possible_s(time_s: f64) -> bool {
        TIMES_S.contains(&time_s)
    }
    /// What a calibration has measured.
    pub fn calibrated(expected: Dynamics) -> Self {
        Self {
            expected,
            uncertainty_s: UNCERTAINTY_MIN_S,
        }
    }

    /// Squared distance of a candidate from the expectation in standard deviations.
    pub fn distance_squared(&self, candidate: &Dynamics) -> f64 {
        let Dynamics { lag_s, delay_s } = self.expected;
        ((candidate.lag_s - lag_s).powi(2) + (candidate.delay_s - delay_s).powi(2))
            / self.uncertainty_s.powi(2)
    }

    /// The range of [`SURE_SIGMAS`].
    pub fn range(&self) -> DynamicsRange {
        let margin_s = SURE_SIGMAS * self.uncertainty_s;
        DynamicsRange {
            best: self.expected,
            response_min_s: (self.expected.response_s() - margin_s).max(0.0),
            response_max_s: self.expected.response_s() + margin_s,
        }
    }
}

/// Lag and dead time in use, and the range that is plausible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DynamicsRange {
    /// The values in use.
    pub best: Dynamics,
    /// Smallest plausible sum of lag and dead time, s.
    pub response_min_s: f64,
    /// Largest plausible sum of lag and dead time, s.
    pub response_max_s: f64,
}

impl DynamicsRange {
    /// What a later start takes as its prior.
    pub fn prior(&self) -> DynamicsPrior {
        DynamicsPrior {
            expected: self.best,
            uncertainty_s: (self.error_max_s() / SURE_SIGMAS).max(UNCERTAINTY_MIN_S),
        }
    }

    /// Largest plausible error of the response time, s.
    pub fn error_max_s(&self) -> f64 {
        let best_s = self.best.response_s();
        let (above_s, below_s) = (self.response_max_s - best_s, best_s - self.response_min_s);
        above_s.max(below_s).max(0.0)
    }
}

/// Smallest uncertainty of a remembered lag or dead time, s: a line may be exchanged or pinched in the meantime.
const UNCERTAINTY_MIN_S: f64 = 0.02;
