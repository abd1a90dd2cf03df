//! Supervision of the orientation sensor: age of the last usable sample, and drift of the gyroscope bias.

use crate::control::{CauseSet, Frame, LoopState, TickPhase};
use crate::primitives::lasting;
use nalgebra::Vector3;

crate::constants! {
    /// When the gyroscope is said to have drifted.
    const WATCH: SensorWatchConstants;
    /// Change of the gyroscope bias since the alignment that is reported, rad/s (0.9 °/s).
    bias_moved_rad_s = 0.016;
    /// Time constant for the rate of a resting tip, s.
    resting_s = 0.5;
    /// Mean rate of a resting tip that is attributed to the sensor, rad/s (0.7 °/s).
    resting_rad_s = 0.012;
}

/// State of the supervision.
#[derive(Debug, Clone, Default)]
pub(super) struct SensorWatch {
    /// Time since the last usable gyroscope sample, s.
    pub(super) blind_s: f64,
    /// Bias-corrected rate of the tip, smoothed, rad/s.
    rate_rad_s: Vector3<f64>,
    /// Time for which the set-point has rested, s.
    resting_s: f64,
}

impl SensorWatch {
    /// One tick of `dt_s`; returns the causes that came into force. The rate is integrated over `paced_s`.
    pub(super) fn step(
        &mut self,
        state: &LoopState,
        frame: &Frame,
        dt_s: f64,
        paced_s: f64,
    ) -> CauseSet {
        let verdict = state.fusion.verdict();
        if let Some(verdict) = &verdict {
            self.blind_s = lasting(!verdict.gyro, self.blind_s, dt_s);
        }
        let rests = frame.estimate.is_some() && frame.phase == TickPhase::Holding;
        self.resting_s = lasting(rests, self.resting_s, paced_s);
        if let Some(rate) = state.fusion.rate_rad_s() {
            let keep = (-paced_s / WATCH.resting_s).exp();
            self.rate_rad_s = rate + (self.rate_rad_s - rate) * keep;
        }
        verdict.map_or(CauseSet::EMPTY, |v| v.raised)
    }

    /// True if the gyroscope bias has changed since the alignment. A tip whose set-point rests does not turn for long, so
    /// a lasting mean rate is an error of the sensor or a rotation of the base.
    pub(super) fn bias_moved(&self, state: &LoopState) -> bool {
        if self.resting_s > 3.0 * WATCH.resting_s && self.rate_rad_s.norm() > WATCH.resting_rad_s {
            return true;
        }
        let fusion = &state.fusion;
        let filter = fusion.estimator().and_then(|e| e.as_bend());
        filter.zip(fusion.alignment()).is_some_and(|(now, rest)| {
            (now.gyro_bias_rad_s() - rest.gyro_bias_rad_s).norm() > WATCH.bias_moved_rad_s
        })
    }
}
