//! Calibration of the transmission while the service runs: poses out, frames in, gains at the end.
//!
//! The measurement is that of [`crate::experiment::identify`], but driven by the frames of the running loop. Algorithm 1
//! (paper, §IV-C) repeats all poses with the latest gains until these change by less than 2 %. The short form is one
//! pass with the present calibration as prior.

use crate::control::DynamicsPrior;
use crate::control::learning::batch::{Prior, relative_step, solve};
use crate::experiment::error::ExperimentError;
use crate::experiment::identify::{CONVERGED, PASSES_MAX, plausible};
use crate::experiment::pose::{Round, Step};
use crate::model::{Line, Shape};
use crate::supervisor::{CycleOutput, Mode};
use nalgebra::Vector3;

/// Next step of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Wait for the next cycle.
    Wait,
    /// Move to this pose.
    Drive(Shape),
    /// Use these gains.
    Lines([Line; 3]),
    /// The calibration has ended.
    Done(Result<Found, String>),
}

/// Transmission parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Gains of channels 1 to 3.
    pub lines: [Line; 3],
    /// Lag and dead time, s.
    pub dynamics: DynamicsPrior,
}

/// A calibration in progress.
#[derive(Debug, Clone)]
pub struct Session {
    step_mm: f64,
    prior: Option<[Prior; 3]>,
    lines: [Line; 3],
    before: Found,
    pass: usize,
    round: Round,
    state: State,
}

/// What the session is waiting for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Mode `calibrating`.
    Mode,
    /// A cycle with the gains of this pass, to command a pose.
    Pose,
    /// The pose to be held for long enough.
    Hold,
}

impl Session {
    /// Algorithm 1 from zero gains, or with a prior, one pass.
    pub fn new(round: Round, step_mm: f64, prior: Option<[Prior; 3]>, before: Found) -> Self {
        let none = Line {
            k_epsilon: 0.0,
            k_lambda_mm: 0.0,
        };
        Self {
            step_mm,
            prior,
            lines: prior.map_or([none; 3], |prior| prior.map(|p| p.line)),
            before,
            pass: 1,
            round,
            state: State::Mode,
        }
    }

    /// Progress, for the status.
    pub fn progress(&self) -> String {
        let (at, of) = self.round.at();
        format!("pass {}, pose {} of {of}", self.pass, at + 1)
    }

    /// Processes the output of one cycle.
    pub fn step(&mut self, output: &CycleOutput) -> Next {
        if output.mode != Mode::Calibrating {
            let started = self.state != State::Mode;
            let ended = || Next::Done(Err(format!("mode {} ended the calibration", output.mode)));
            return if started { ended() } else { Next::Wait };
        }
        let piston_mm = Vector3::from(output.counted.0.map(|n| f64::from(n) * self.step_mm));
        match self.state {
            State::Mode => {
                self.state = State::Pose;
                Next::Lines(self.lines)
            }
            State::Pose => {
                self.round.follow(&piston_mm);
                self.state = State::Hold;
                Next::Drive(self.round.command())
            }
            State::Hold => match self.round.step(&output.frame, &piston_mm, output.dt_s) {
                Step::Waiting => Next::Wait,
                Step::Next => Next::Drive(self.round.command()),
                Step::Over => self.conclude(),
            },
        }
    }

    fn conclude(&mut self) -> Next {
        let found = solve(&self.round.data, self.prior.as_ref()).map_err(ExperimentError::from);
        let next = match found.and_then(|channels| plausible(&channels)) {
            Ok(next) => next,
            Err(e) => return Next::Done(Err(e.to_string())),
        };
        let converged = self.prior.is_some() || relative_step(&next, &self.lines) < CONVERGED;
        self.lines = next;
        if converged {
            return Next::Done(Ok(Found {
                lines: next,
                dynamics: self.round.dynamics(&self.before.dynamics),
            }));
        }
        if self.pass >= PASSES_MAX {
            return Next::Done(Err(format!(
                "Algorithm 1 did not converge in {PASSES_MAX} passes; use the short form, or check for a leak"
            )));
        }
        self.pass += 1;
        self.round.again();
        self.state = State::Pose;
        Next::Lines(next)
    }
}
