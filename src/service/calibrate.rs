//! Calibration of the transmission while the service runs: [`Algorithm1`], driven by the frames of the running loop. The
//! short form is one pass with the present calibration as prior.

use crate::control::learning::identify::{Algorithm1, Identified, Next, PASSES_MAX};
use crate::model::Drive;
use crate::supervisor::{CycleOutput, Mode};

/// A calibration in progress.
#[derive(Debug, Clone)]
pub struct Session {
    drive: Drive,
    algorithm: Algorithm1,
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
    /// A session that waits for the mode `calibrating`.
    pub fn new(algorithm: Algorithm1, drive: Drive) -> Self {
        let state = State::Mode;
        Self {
            drive,
            algorithm,
            state,
        }
    }

    /// Progress, for the status.
    pub fn progress(&self) -> String {
        let (at, of) = self.algorithm.at();
        let pass = self.algorithm.pass();
        format!("pass {pass}, pose {} of {of}", at + 1)
    }

    /// Processes the output of one cycle.
    ///
    /// # Errors
    /// Why the calibration has failed.
    pub fn step(&mut self, output: &CycleOutput) -> Result<Next, String> {
        if output.mode != Mode::Calibrating {
            return match self.state {
                State::Mode => Ok(Next::Wait),
                _ => Err(format!("mode {} ended the calibration", output.mode)),
            };
        }
        let piston_mm = self.drive.piston_mm(&output.counted);
        match self.state {
            State::Mode => {
                self.state = State::Pose;
                Ok(Next::Lines(self.algorithm.lines()))
            }
            State::Pose => {
                self.algorithm.follow(&piston_mm);
                self.state = State::Hold;
                Ok(Next::Drive(self.algorithm.command()))
            }
            State::Hold => {
                let next = self.algorithm.step(&output.frame, &piston_mm, output.dt_s);
                match next.map_err(|e| format!("identification: {e}"))? {
                    Next::Done(Identified {
                        converged: false, ..
                    }) => Err(format!(
                        "Algorithm 1 did not converge in {PASSES_MAX} passes; use the short form, or check for a leak"
                    )),
                    Next::Lines(lines) => {
                        self.state = State::Pose;
                        Ok(Next::Lines(lines))
                    }
                    next => Ok(next),
                }
            }
        }
    }
}
