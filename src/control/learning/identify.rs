//! Algorithm 1 of the paper (§IV-C): apply k, hold the poses, solve Eq. 25, repeat until k changes by less than 2 %.
//!
//! The IMU measures the bend; the counted steps give the side of each piston ([`super::pose`]). The last pass also yields
//! lag and dead time.

use crate::control::learning::batch::{Estimate, Prior, Unidentifiable, relative_step, solve};
use crate::control::learning::pose::{Round, Step};
use crate::control::{DynamicsPrior, Frame};
use crate::model::{Line, Shape};
use nalgebra::Vector3;

/// The paper's criterion: relative step below 2 %.
const CONVERGED: f64 = 0.02;
/// Share by which k_ε changes from one calibration to the next: the absolute temperature of the air in a line rises by 5 % from a room
/// at 22 °C to a body at 37 °C.
const WARMED: f64 = 0.05;
/// Largest number of passes.
pub const PASSES_MAX: usize = 12;

/// Result of an identification.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Gains with covariance, per channel.
    pub channels: [Estimate; 3],
    /// Lag and dead time.
    pub dynamics: DynamicsPrior,
    /// Gains initially and after every pass.
    pub history: Vec<[Line; 3]>,
    /// The criterion of 2 % was reached.
    pub converged: bool,
}

impl Identified {
    /// The gains without their uncertainty.
    pub fn lines(&self) -> [Line; 3] {
        self.channels.map(|e| e.line)
    }

    /// Standard deviations of k_ε and k_λ in mm, per channel. They cover how far a later calibration of the same tip differs.
    pub fn line_sigmas(&self) -> [[f64; 2]; 3] {
        self.channels.map(|e| {
            let variance = |i| e.covariance[(i, i)].max(0.0);
            let later = WARMED * e.line.k_epsilon;
            let k_lambda_mm = f64::sqrt(variance(1)).max(0.03);
            [(variance(0) + later * later).sqrt(), k_lambda_mm]
        })
    }
}

/// Next step of an identification.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Wait for the next frame.
    Wait,
    /// Move to this pose.
    Drive(Shape),
    /// Use these gains, then move to the first pose.
    Lines([Line; 3]),
    /// The identification has ended.
    Done(Identified),
}

/// Algorithm 1 in progress, for whoever runs the loop: frames in, poses and gains out.
#[derive(Debug, Clone)]
pub struct Algorithm1 {
    /// The poses of this pass.
    pub round: Round,
    prior: Option<[Prior; 3]>,
    before: DynamicsPrior,
    history: Vec<[Line; 3]>,
}

impl Algorithm1 {
    /// Starts with the gains `start`. With a prior it starts at the gains of the prior and makes one pass: the short
    /// calibration of a new tip. `before` is what is known of lag and dead time.
    pub fn new(
        round: Round,
        start: [Line; 3],
        prior: Option<[Prior; 3]>,
        before: DynamicsPrior,
    ) -> Self {
        Self {
            round,
            prior,
            before,
            history: vec![prior.map_or(start, |prior| prior.map(|p| p.line))],
        }
    }

    /// Gains of this pass.
    pub fn lines(&self) -> [Line; 3] {
        self.history[self.pass() - 1]
    }

    /// Number of this pass, from 1.
    pub fn pass(&self) -> usize {
        self.history.len()
    }

    /// Processes one frame of `dt_s` after a command; `piston_mm` are the counted positions.
    ///
    /// # Errors
    /// [`Unidentifiable`] from the data.
    pub fn step(
        &mut self,
        frame: &Frame,
        piston_mm: &Vector3<f64>,
        dt_s: f64,
    ) -> Result<Next, Unidentifiable> {
        match self.round.step(frame, piston_mm, dt_s) {
            Step::Waiting => Ok(Next::Wait),
            Step::Next => Ok(Next::Drive(self.round.command())),
            Step::Over => self.conclude(),
        }
    }

    fn conclude(&mut self) -> Result<Next, Unidentifiable> {
        let channels = solve(&self.round.data, self.prior.as_ref())?;
        let (before, now) = (self.lines(), plausible(&channels)?);
        let converged = self.prior.is_some() || relative_step(&now, &before) < CONVERGED;
        let last = converged || self.pass() >= PASSES_MAX;
        self.history.push(now);
        if last {
            return Ok(Next::Done(Identified {
                channels,
                dynamics: self.round.dynamics(&self.before),
                history: std::mem::take(&mut self.history),
                converged,
            }));
        }
        self.round.again();
        Ok(Next::Lines(now))
    }
}

/// The gains of `channels`, if they are within the physical range.
fn plausible(channels: &[Estimate; 3]) -> Result<[Line; 3], Unidentifiable> {
    for (i, e) in channels.iter().enumerate() {
        let (k_epsilon, k_lambda_mm) = (e.line.k_epsilon, e.line.k_lambda_mm);
        if !(0.0..=10.0).contains(&k_epsilon) || !(-0.3..=3.0).contains(&k_lambda_mm) {
            return Err(Unidentifiable::Unphysical {
                channel: i + 1,
                k_epsilon,
                k_lambda_mm,
            });
        }
    }
    // noise may make a small backlash slightly negative
    Ok(channels.map(|e| Line {
        k_lambda_mm: e.line.k_lambda_mm.max(0.0),
        ..e.line
    }))
}
