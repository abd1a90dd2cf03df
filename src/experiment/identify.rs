//! Algorithm 1 of the paper on a world: apply k, hold the poses, solve Eq. 25, repeat until k changes by less than 2 %.
//!
//! The IMU measures the bend; the counted steps give the side of each piston ([`super::pose`]). The last pass also yields
//! lag and dead time.

use crate::control::learning::batch::{Estimate, Prior, relative_step, solve};
use crate::control::{DynamicsPrior, LoopConfig};
use crate::experiment::error::ExperimentError;
use crate::experiment::pose::{Round, Step};
use crate::experiment::rig::Rig;
use crate::experiment::schedule::Pose;
use crate::model::Line;
use crate::simulation::world::World;

/// The paper's criterion: relative step below 2 %.
pub const CONVERGED: f64 = 0.02;
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

    /// Standard deviations of k_ε and k_λ in mm, per channel, no smaller than a calibration is repeatable.
    pub fn line_sigmas(&self) -> [[f64; 2]; 3] {
        self.channels.map(|e| {
            let sigma = |i, least| e.covariance[(i, i)].max(0.0).sqrt().max(least);
            [sigma(0, 0.05), sigma(1, 0.03)]
        })
    }
}

/// Runs Algorithm 1 on one world, starting at `config.lines`. With a prior it starts at the gains of the prior and makes
/// one pass: the short calibration of a new tip.
///
/// # Errors
/// [`ExperimentError`] from the world or the data.
pub fn algorithm_1(
    config: &LoopConfig,
    world: &mut dyn World,
    poses: &[Pose],
    prior: Option<&[Prior; 3]>,
    progress: &mut dyn FnMut(usize),
) -> Result<Identified, ExperimentError> {
    let mut now = prior.map_or(config.lines, |p| p.map(|p| p.line));
    let open = LoopConfig {
        feedback: None,
        ..config.clone()
    };
    let mut rig = Rig::new(open, world);
    rig.align()?;
    let mut history = vec![now];
    let mut round = Round::new(config.geometry, poses.to_vec());
    loop {
        rig.relearn(now);
        round.again();
        hold(&mut rig, &mut round, &mut || progress(history.len()))?;
        let channels = solve(&round.data, prior)?;
        let before = std::mem::replace(&mut now, plausible(&channels)?);
        history.push(now);
        let converged = prior.is_some() || relative_step(&now, &before) < CONVERGED;
        if converged || history.len() > PASSES_MAX {
            return Ok(Identified {
                channels,
                dynamics: round.dynamics(&config.dynamics),
                history,
                converged,
            });
        }
    }
}

/// The gains of `channels`, if they are within the physical range.
///
/// # Errors
/// [`ExperimentError::Unphysical`].
pub fn plausible(channels: &[Estimate; 3]) -> Result<[Line; 3], ExperimentError> {
    for (i, e) in channels.iter().enumerate() {
        let (k_epsilon, k_lambda_mm) = (e.line.k_epsilon, e.line.k_lambda_mm);
        if !(0.0..=10.0).contains(&k_epsilon) || !(-0.3..=3.0).contains(&k_lambda_mm) {
            return Err(ExperimentError::Unphysical {
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

/// Holds all poses once.
fn hold(
    rig: &mut Rig<'_>,
    round: &mut Round,
    progress: &mut dyn FnMut(),
) -> Result<(), ExperimentError> {
    let mut command = Some(round.command());
    loop {
        let (frame, sensed) = rig.advance(command.take())?;
        let piston_mm = rig.config.drive.piston_mm(&sensed.counted);
        let step = round.step(&frame, &piston_mm, rig.period_s());
        if step != Step::Waiting {
            progress();
        }
        match step {
            Step::Waiting => {}
            Step::Next => command = Some(round.command()),
            Step::Over => return Ok(()),
        }
    }
}
