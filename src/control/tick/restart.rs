//! State that outlives a restart of the loop.

use super::state::LoopState;
use super::types::LoopConfig;
use crate::control::dynamics::{Dynamics, DynamicsPrior};
use crate::control::observer::laws::LAWS;
use crate::model::{Bend, Line};
use crate::primitives::Steps;
use nalgebra::Vector2;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

/// State to be remembered for a restart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestartState {
    /// Microsteps counted since zero.
    pub steps: Steps,
    /// Estimated bend vector, rad.
    pub bend_rad: [f64; 2],
    /// Outputs of the play operators, mm of piston.
    pub play_output_mm: [f64; 3],
    /// Refined extension gains.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths, mm.
    pub k_lambda_mm: [f64; 3],
    /// Learned lag, s.
    pub lag_s: f64,
    /// Learned dead time, s.
    pub delay_s: f64,
    /// Standard deviation of both, s.
    #[serde(default = "unknown_s")]
    pub dynamics_uncertainty_s: f64,
    /// Of an earlier version; without a meaning now.
    #[serde(default, skip_serializing)]
    pub caution: IgnoredAny,
    /// What the observer has learned; none in the memory of an earlier version.
    #[serde(default)]
    pub laws: Option<RestartLaws>,
    /// Rest pose, once it is known.
    pub rest: Option<RestartRest>,
}

/// Parameters of the laws along the pistons, in the order of [`crate::control::observer::laws`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestartLaws {
    /// Extension gains to which the gain parameters are relative.
    pub k_epsilon: [f64; 3],
    /// Values, then standard deviations.
    pub parameters: [[f64; LAWS]; 2],
}

impl RestartLaws {
    fn is_possible(&self) -> bool {
        let [values, sigmas] = &self.parameters;
        let lines = Line::each(self.k_epsilon, [0.0; 3]);
        lines.iter().all(Line::is_possible)
            && values.iter().all(|x| x.abs() <= PARAMETER_MAX)
            && sigmas.iter().all(|x| (0.0..=PARAMETER_MAX).contains(x))
    }
}

impl RestartState {
    /// True if a machine can have these values.
    pub fn is_possible(&self) -> bool {
        let times_s = [self.lag_s, self.delay_s, self.dynamics_uncertainty_s];
        let bend_rad = Vector2::from(self.bend_rad).norm();
        let lines = Line::each(self.k_epsilon, self.k_lambda_mm);
        lines.iter().all(Line::is_possible)
            && times_s.into_iter().all(DynamicsPrior::is_possible_s)
            && bend_rad <= std::f64::consts::PI
            && self.play_output_mm.iter().all(|w| w.abs() <= PISTON_MAX_MM)
            && self.steps.0.iter().all(|n| n.unsigned_abs() <= STEPS_MAX)
            && self.laws.is_none_or(|laws| laws.is_possible())
            && self.rest.is_none_or(|rest| rest.is_possible())
    }
}

/// Largest parameter of a law, in its unit, in any memory.
const PARAMETER_MAX: f64 = 10.0;
/// Largest travel of a piston, mm, in any memory.
const PISTON_MAX_MM: f64 = 1000.0;
/// Largest count, and largest reading at rest in its unit, in any memory.
const STEPS_MAX: u32 = 1_000_000_000;
const READING_MAX: f64 = 1e6;

/// Uncertainty of lag and dead time in a memory that does not state it, s.
fn unknown_s() -> f64 {
    0.3
}

/// Rest pose of the alignment, in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestartRest {
    /// Mean specific force, m/s².
    pub acc_m_s2: [f64; 3],
    /// Mean field, µT, if there is a magnetometer.
    pub mag_ut: Option<[f64; 3]>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
}

impl RestartRest {
    fn is_possible(&self) -> bool {
        let all = self.acc_m_s2.iter().chain(&self.gyro_bias_rad_s);
        all.chain(self.mag_ut.iter().flatten())
            .all(|reading| reading.abs() <= READING_MAX)
    }
}

impl LoopState {
    /// The state to be remembered, with the pistons at these counts.
    pub fn keep(&self, steps: &Steps) -> RestartState {
        let rest = self.fusion.alignment().map(|r| RestartRest {
            acc_m_s2: r.acc_rest_m_s2.into(),
            mag_ut: r.mag_rest_ut.map(Into::into),
            gyro_bias_rad_s: r.gyro_bias_rad_s.into(),
        });
        let dynamics = self.dynamics.prior();
        RestartState {
            steps: *steps,
            bend_rad: self.fusion.estimate().map_or([0.0; 2], |f| f.bend.0.into()),
            play_output_mm: self.observer.now.play.map(|play| play.w_mm),
            k_epsilon: self.lines.map(|l| l.k_epsilon),
            k_lambda_mm: self.lines.map(|l| l.k_lambda_mm),
            lag_s: dynamics.expected.lag_s,
            delay_s: dynamics.expected.delay_s,
            dynamics_uncertainty_s: dynamics.uncertainty_s,
            caution: IgnoredAny,
            laws: Some(RestartLaws {
                k_epsilon: self.observer.lines.map(|l| l.k_epsilon),
                parameters: self.observer.learned(),
            }),
            rest,
        }
    }

    /// Restores the position of the pistons and the learned values, before an alignment.
    pub fn take_up(&mut self, config: &LoopConfig, remembered: &RestartState) {
        self.before = DynamicsPrior {
            expected: Dynamics {
                lag_s: remembered.lag_s,
                delay_s: remembered.delay_s,
            },
            uncertainty_s: remembered.dynamics_uncertainty_s,
        };
        self.dynamics = self.before.range();
        let published = remembered.k_epsilon;
        let gains = remembered.laws.map_or(published, |laws| laws.k_epsilon);
        self.set_lines(config, Line::each(gains, remembered.k_lambda_mm));
        if let Some(laws) = &remembered.laws {
            self.observer.assume(&laws.parameters);
        }
        if self.described.is_none() {
            self.lines = Line::each(published, remembered.k_lambda_mm);
        }
        let piston_mm = config.drive.piston_mm(&remembered.steps);
        self.observer
            .rest(&remembered.play_output_mm.into(), &piston_mm);
        self.stand(config, &remembered.steps, Bend(remembered.bend_rad.into()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Board, Calibration, Gains, assemble, source};

    #[test]
    fn a_restart_goes_on_with_what_was_learned() {
        let board: Board =
            source::parse("sim.toml", include_str!("../../../boards/sim.toml")).unwrap();
        let calib: Calibration =
            source::parse("paper.toml", include_str!("../../../calib/paper.toml")).unwrap();
        let config = assemble(&board, &calib, &Gains::default());
        let mut before = LoopState::new(&config);
        let mut learned = before.observer.learned();
        for (k, value) in learned[0].iter_mut().enumerate() {
            *value = 1e-3 * (k + 1) as f64;
        }
        learned[1] = learned[1].map(|sigma| 0.3 * sigma);
        before.observer.assume(&learned);
        let kept = before.keep(&Steps([120, -40, 10]));
        assert!(kept.is_possible());
        let mut after = LoopState::new(&config);
        after.take_up(&config, &kept);
        let again = after.observer.learned();
        assert_eq!(again[0], learned[0]);
        assert!(
            again[1]
                .iter()
                .zip(learned[1])
                .all(|(a, b)| (a - b).abs() < 1e-12)
        );
        // the play is part of the operators, not of the parameters
        assert_eq!(after.keep(&kept.steps).k_lambda_mm, kept.k_lambda_mm);
    }
}
