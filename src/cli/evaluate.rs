//! `retroflex evaluate`: the paper's experiment on a plant; `--sweep` and `--ablate`: studies on the built-in plant.

pub mod args;
mod studies;

use crate::cli::{gap, inputs, logging, output};
use crate::config::{Board, Calibration, LoopConfig, PlantSection, assemble, source};
use crate::experiment::arm::ArmResult;
use crate::experiment::evaluation::{self, Arm, Evaluation, Plan, Purpose, Track};
use crate::experiment::path;
use crate::experiment::track::TrackResult;
use crate::report::evaluation as pictures;
use crate::simulation::described::Described;
use crate::simulation::link::Link;
use crate::simulation::sim::Sim;
use crate::simulation::world::World;
use crate::supervisor::MachineError;
use args::Args;
use miette::{IntoDiagnostic, Result, bail, miette};
use std::path::Path;

/// Closed-loop bend RMSE above which the command exits with 1, degrees.
const GOOD_ENOUGH_DEG: f64 = 1.5;
/// RMSE along a path, after its delay, above which the command exits with 1, degrees.
const FOLLOWED_DEG: f64 = 3.0;

/// Runs the command.
///
/// # Errors
/// A report that says what was wrong with the input or the plant.
pub fn run(args: &Args) -> Result<bool> {
    let arms = args.arms.as_deref().unwrap_or_default();
    for (n, arm) in arms.iter().enumerate() {
        if arms[..n].contains(arm) {
            bail!("--arms names `{}` twice; name each arm once", arm.name());
        }
    }
    let board = inputs::board(args.board.as_deref())?;
    let gains = inputs::gains(args.gains.as_deref())?;
    if args.sweep || args.ablate {
        return studies::run(args, &built_in(args, &board)?, &board, &gains);
    }
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let (open, is_foreign) = plant(args, &board)?;
    let _logging = is_foreign.then(logging::start);
    let identify = calibration.is_none();
    let calibration = calibration.unwrap_or_default();
    let feedforward = inputs::feedforward(&args.feedforward, &args.calib, &calibration, &board)?;
    let config = assemble(&board, &calibration, &gains);
    let track = track(args, &config)?;
    let usual: &[Arm] = if track.is_some() { &[] } else { &Arm::ALL };
    let plan = Plan {
        identify,
        config,
        arms: args.arms.clone().unwrap_or(usual.to_vec()),
        track,
        seed: args.seed,
        rig: gap::input::rig(args.board.as_deref())?,
        feedforward: feedforward.map(|(_, machine)| machine),
    };
    let bar = output::bar(0, "{msg:<18} {pos} states held,");
    let result = evaluation::run(&plan, &mut |purpose| open(purpose), &mut |what| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    });
    bar.finish_and_clear();
    let result = result.into_diagnostic()?;
    output::write_some(&args.html, || Ok(pictures::html(&result)))?;
    output::write_some(&args.svg, || Ok(pictures::svg(&result)))?;
    output::answer(&args.json, &result, pictures::summary(&result))?;
    if let Some(warning) = result.track.as_ref().and_then(pictures::too_fast) {
        eprintln!("warning: {warning}");
    }
    Ok(verdict(&result))
}

/// The path of `--track`, within the reach of the machine as far as it is known before an identification.
fn track(args: &Args, config: &LoopConfig) -> Result<Option<Track>> {
    let Some(file) = &args.track else {
        return Ok(None);
    };
    let path = path::PathFile::open(file, &config.geometry).into_diagnostic()?;
    let within = path.within(&config.limits, &config.geometry, &config.lines);
    within.into_diagnostic()?;
    let live = args.live;
    Ok(Some(Track { path, live }))
}

/// Opens the plant that a run drives.
type Open = Box<dyn Fn(Purpose) -> Result<Box<dyn World>, MachineError>>;

/// The plant that the arms run on, and whether it is a foreign program.
fn plant(args: &Args, board: &Board) -> Result<(Open, bool)> {
    let (seed, foreign) = (args.seed, args.plant.as_deref());
    if let Some(path) = foreign.and_then(|plant| plant.strip_prefix("model:")) {
        let machine = inputs::described(Path::new(path), board)?;
        let step_mm = board.drive.law().step_mm;
        let open: Open = Box::new(move |purpose| {
            let noise = seed.wrapping_add(noise_of(purpose));
            let machine = machine.as_ref().clone();
            Ok(Box::new(Described::new(machine, step_mm, noise)))
        });
        return Ok((open, false));
    }
    if let Some(plant) = foreign {
        let (program, args) = inputs::program(plant)?;
        let open: Open = Box::new(move |_| Ok(Box::new(Link::start(&program, &args)?)));
        return Ok((open, true));
    }
    let section = built_in(args, board)?;
    let open: Open = Box::new(move |purpose| {
        let (plant, noise) = (section.make(), noise_of(purpose));
        Ok(Box::new(Sim::new(&plant, seed, noise, section.period_s)?))
    });
    Ok((open, false))
}

/// The built-in plant of a board.
fn built_in(args: &Args, board: &Board) -> Result<PlantSection> {
    board.plant.clone().ok_or_else(|| {
        let name = args.board.as_deref().unwrap_or(Path::new("boards/sim.toml")).display();
        miette!(
            "{name} has no [plant] table, so there is nothing to run on; give --plant 'exec:PROGRAM ARG…' or a board that describes a plant"
        )
    })
}

/// Seed of the noise: each run has its own, independent of the selection of arms.
fn noise_of(purpose: Purpose) -> u64 {
    match purpose {
        Purpose::Identify => 0,
        Purpose::Arm(arm) => 1 + arm as u64,
        Purpose::Record => 1 + Arm::ALL.len() as u64,
        Purpose::Track => 2 + Arm::ALL.len() as u64,
    }
}

fn verdict(e: &Evaluation) -> bool {
    let bad = |a: &ArmResult| a.bend_rmse_deg > GOOD_ENOUGH_DEG;
    let lost = |t: &TrackResult| t.rmse_delayed_deg > FOLLOWED_DEG;
    let failed = e.track.as_ref().is_some_and(lost) || e.arm(Arm::Closed).is_some_and(bad);
    e.converged && !failed
}
