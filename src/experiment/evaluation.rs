//! The evaluation: identification on a plant of its own, then every arm on a fresh plant.

use crate::control::LoopConfig;
use crate::control::learning::identify::Identified;
use crate::control::learning::schedule::{DIRECTIONS, arrivals, paper};
use crate::diagnosis;
use crate::experiment::arm::{self, ArmResult};
use crate::experiment::diagnosed;
use crate::experiment::error::ExperimentError;
use crate::experiment::identify;
use crate::experiment::path::PathFile;
use crate::experiment::rig::Rig;
use crate::experiment::track::{self, TrackResult};
use crate::model::{DescribedMachine, nominal_theta};
use crate::simulation::MachineError;
use crate::simulation::described::Described;
use crate::simulation::world::World;
use serde::Serialize;
use std::sync::Arc;

/// An arm: what the controller compensates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arm {
    /// Kinematics alone.
    None,
    /// Kinematics and extension.
    Extension,
    /// Kinematics, extension and backlash.
    Backlash,
    /// All of it, with orientation feedback.
    Closed,
    /// Open loop through the inverse of the model that a diagnosis has saved.
    Diagnosed,
}

impl Arm {
    /// All, in the order of the paper; the diagnosis comes before the feedback.
    pub const ALL: [Self; 5] = [
        Self::None,
        Self::Extension,
        Self::Backlash,
        Self::Diagnosed,
        Self::Closed,
    ];
    /// Those of the paper.
    pub const PAPER: [Self; 4] = [Self::None, Self::Extension, Self::Backlash, Self::Closed];

    /// Name on the command line and in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Extension => "extension",
            Self::Backlash => "backlash",
            Self::Closed => "closed",
            Self::Diagnosed => "diagnosed",
        }
    }

    /// Configuration of this arm, derived from that of the closed loop.
    pub fn config(self, base: &LoopConfig) -> LoopConfig {
        let mut config = base.clone();
        for line in &mut config.lines {
            if self == Self::None {
                line.k_epsilon = 0.0;
            }
            if matches!(self, Self::None | Self::Extension) {
                line.k_lambda_mm = 0.0;
            }
        }
        config.feedback = config.feedback.filter(|_| self == Self::Closed);
        config
    }

    /// Runs this arm in so many directions on a fresh world, with a configuration derived from that of the closed loop;
    /// `progress` is called after every scored state.
    ///
    /// # Errors
    /// [`ExperimentError`] as of [`arm::run`].
    pub fn run(
        self,
        base: &LoopConfig,
        world: &mut dyn World,
        directions: usize,
        progress: &mut dyn FnMut(),
    ) -> Result<ArmResult, ExperimentError> {
        let mut rig = Rig::new(self.config(&for_world(base, world)), world);
        arm::run(self.name(), &mut rig, &arrivals(directions), progress)
    }
}

/// Purpose of a world; each gets a fresh one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Algorithm 1.
    Identify,
    /// A log for the diagnosis.
    Record,
    /// One arm.
    Arm(Arm),
    /// The path.
    Track,
}

/// Uncertainty of the gains of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ChannelFigures {
    /// 1 σ of k_ε, with what changes until a later calibration.
    pub k_eps_sigma: f64,
    /// 1 σ of k_λ, mm.
    pub k_lambda_sigma_mm: f64,
    /// Condition number of the scaled normal matrix.
    pub condition: f64,
    /// Root mean square residual, mm of piston.
    pub residual_mm: f64,
}

impl ChannelFigures {
    /// Of each channel.
    fn of(found: &Identified) -> [Self; 3] {
        let (lines, later) = (found.line_sigmas(), found.later_sigmas());
        std::array::from_fn(|i| Self {
            k_eps_sigma: later[i],
            k_lambda_sigma_mm: lines[i][1],
            condition: found.channels[i].condition,
            residual_mm: found.channels[i].residual_mm,
        })
    }
}

/// The bend RMSE of an open-loop arm, and what two simulations foretell of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Predicted {
    /// Arm name.
    pub name: String,
    /// On the machine, degrees.
    pub machine_deg: f64,
    /// On the machine that a diagnosis has described, degrees.
    pub twin_deg: f64,
    /// On the nominal model with the calibrated gains, degrees.
    pub nominal_deg: f64,
}

/// Result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// Name of the plant.
    pub plant: String,
    /// Seed of the built-in plant.
    pub seed: u64,
    /// Arms in the requested order.
    pub arms: Vec<ArmResult>,
    /// The path, if one was driven.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track: Option<TrackResult>,
    /// What simulations foretell of the open-loop arms, where a described machine was used.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub foretold: Vec<Predicted>,
    /// Extension gains used.
    pub k_eps: [f64; 3],
    /// Backlash half-widths used, mm.
    pub k_lambda_mm: [f64; 3],
    /// Initial lag, s.
    pub lag_s: f64,
    /// Initial dead time, s.
    pub delay_s: f64,
    /// Passes of Algorithm 1; 0 with a calibration.
    pub iterations: usize,
    /// The identification reached the paper's 2 %, or a calibration was given.
    pub converged: bool,
    /// `[k_ε, k_λ in mm]` per channel, initially and after every pass.
    pub history: Vec<[[f64; 2]; 3]>,
    /// Uncertainty of the identified gains; empty with a calibration.
    pub identified: Vec<ChannelFigures>,
}

impl Evaluation {
    /// Result of an arm, if it ran.
    pub fn arm(&self, arm: Arm) -> Option<&ArmResult> {
        self.arms.iter().find(|a| a.name == arm.name())
    }
}

/// Plan of an evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Configuration of the loop, with the calibrated gains or the initial gains of Algorithm 1.
    pub config: LoopConfig,
    /// Identify the gains first.
    pub identify: bool,
    /// Arms to run.
    pub arms: Vec<Arm>,
    /// Path to drive after the arms, in closed loop.
    pub track: Option<Track>,
    /// Seed, for the record.
    pub seed: u64,
    /// The machine as the diagnosis knows it.
    pub rig: diagnosis::tip::rig::Rig,
    /// The described machine for the arms `diagnosed` and `closed`. Without one, `diagnosed` diagnoses a log of its own.
    pub feedforward: Option<Arc<DescribedMachine>>,
}

/// A path to drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// The path.
    pub path: PathFile,
    /// Each point becomes known only at its time.
    pub live: bool,
}

/// Runs an evaluation; `open` makes a fresh world at rest, and `progress` receives a description after every held state.
///
/// # Errors
/// [`ExperimentError`] from a world, if the data do not determine the gains, or if the path is out of reach.
pub fn run(
    plan: &Plan,
    open: &mut dyn FnMut(Purpose) -> Result<Box<dyn World>, MachineError>,
    progress: &mut dyn FnMut(&str),
) -> Result<Evaluation, ExperimentError> {
    let (mut base, mut found, mut plant) = (plan.config.clone(), None, String::new());
    let mut opened = |purpose| -> Result<Box<dyn World>, ExperimentError> {
        let world = open(purpose)?;
        plant.clone_from(&world.info().name);
        Ok(world)
    };
    if plan.identify {
        let mut world = opened(Purpose::Identify)?;
        found = Some(identified(&mut base, world.as_mut(), progress)?);
    }
    let mut arms = Vec::with_capacity(plan.arms.len());
    let mut twin = plan.feedforward.clone();
    for &arm in &plan.arms {
        let mut described = plan.feedforward.clone();
        if described.is_none() && arm == Arm::Diagnosed {
            progress("diagnose");
            let mut world = opened(Purpose::Record)?;
            let config = for_world(&base, world.as_ref());
            let machine = diagnosed::described(&config, &plan.rig, world.as_mut())?;
            described = Some(Arc::new(machine));
        }
        twin = twin.or_else(|| described.clone());
        let uses = matches!(arm, Arm::Diagnosed | Arm::Closed);
        let config = fed_forward(&base, described.filter(|_| uses));
        let mut world = opened(Purpose::Arm(arm))?;
        let name = format!("arm {}", arm.name());
        let mut told = || progress(&name);
        arms.push(arm.run(&config, world.as_mut(), DIRECTIONS, &mut told)?);
    }
    let foretold = match twin {
        Some(machine) => foretell(&base, &machine, plan.seed, &arms)?,
        None => vec![],
    };
    let mut track = None;
    if let Some(wanted) = &plan.track {
        wanted
            .path
            .within(&base.limits, &base.geometry, &base.lines)?;
        let config = fed_forward(&base, plan.feedforward.clone());
        let mut world = opened(Purpose::Track)?;
        let mut told = || progress("path");
        track = Some(followed(wanted, &config, world.as_mut(), &mut told)?);
    }
    let history = found.iter().flat_map(|f| &f.history);
    Ok(Evaluation {
        seed: plan.seed,
        arms,
        track,
        foretold,
        k_eps: base.lines.map(|l| l.k_epsilon),
        k_lambda_mm: base.lines.map(|l| l.k_lambda_mm),
        lag_s: base.dynamics.expected.lag_s,
        delay_s: base.dynamics.expected.delay_s,
        iterations: found.as_ref().map_or(0, |f| f.history.len() - 1),
        converged: found.as_ref().is_none_or(|f| f.converged),
        history: history
            .map(|lines| lines.map(|l| [l.k_epsilon, l.k_lambda_mm]))
            .collect(),
        identified: found.iter().flat_map(ChannelFigures::of).collect(),
        plant,
    })
}

/// Identifies the machine, and gives what is found to the configuration.
fn identified(
    base: &mut LoopConfig,
    world: &mut dyn World,
    progress: &mut dyn FnMut(&str),
) -> Result<Identified, ExperimentError> {
    let config = for_world(base, world);
    let mut told = |pass| progress(&format!("identify, pass {pass}"));
    let found = identify::algorithm_1(&config, world, &paper(), None, &mut told)?;
    (base.lines, base.dynamics, base.line_sigmas) =
        (found.lines(), found.dynamics, found.line_sigmas());
    Ok(found)
}

/// Follows the path.
fn followed(
    wanted: &Track,
    config: &LoopConfig,
    world: &mut dyn World,
    progress: &mut dyn FnMut(),
) -> Result<TrackResult, ExperimentError> {
    let mut rig = Rig::new(for_world(config, world), world);
    track::run(&mut rig, &wanted.path.path, wanted.live, progress)
}

fn fed_forward(config: &LoopConfig, machine: Option<Arc<DescribedMachine>>) -> LoopConfig {
    match machine {
        Some(machine) => config.clone().fed_forward(machine),
        None => config.clone(),
    }
}

/// Runs the open-loop arms on the described machine and on the nominal model.
fn foretell(
    base: &LoopConfig,
    machine: &DescribedMachine,
    seed: u64,
    arms: &[ArmResult],
) -> Result<Vec<Predicted>, ExperimentError> {
    let theta = nominal_theta(&base.lines, base.dynamics.expected.lag_s);
    let nominal = DescribedMachine::new(machine.geometry, machine.rest, &theta, vec![]);
    let run = |machine: &DescribedMachine, arm: Arm| {
        let mut world = Described::new(machine.clone(), base.drive.step_mm, seed);
        let result = arm.run(base, &mut world, DIRECTIONS, &mut || ());
        result.map(|result| result.bend_rmse_deg)
    };
    let mut all = Vec::new();
    for arm in [Arm::None, Arm::Extension, Arm::Backlash] {
        let Some(ran) = arms.iter().find(|a| a.name == arm.name()) else {
            continue;
        };
        all.push(Predicted {
            name: arm.name().to_owned(),
            machine_deg: ran.bend_rmse_deg,
            twin_deg: run(machine, arm)?,
            nominal_deg: run(&nominal, arm)?,
        });
    }
    Ok(all)
}

/// The configuration with step and rest length of the world in place of those of the board.
pub fn for_world(config: &LoopConfig, world: &dyn World) -> LoopConfig {
    let info = world.info();
    let mut config = config.clone();
    config.drive.step_mm = info.step_mm;
    config.geometry.rest_length_mm = info.rest_length_mm;
    config
}
