//! `retroflex evaluate`: the paper's experiment on a plant; `--sweep` and `--ablate`: studies on the built-in plant.

mod studies;

use crate::cli::{CommandOutcome, gap, inputs, logging, output};
use crate::config::assemble;
use crate::config::source;
use crate::config::{Board, Calibration, PlantSection};
use crate::control::LoopConfig;
use crate::experiment::arm::ArmResult;
use crate::experiment::evaluation::{self, Arm, Evaluation, Foretold, Plan, Purpose, Track};
use crate::experiment::path;
use crate::experiment::track::TrackResult;
use crate::model::DescribedMachine;
use crate::report::evaluation as pictures;
use crate::simulation::described::Described;
use crate::simulation::link::Link;
use crate::simulation::sim::Sim;
use crate::simulation::world::World;
use crate::supervisor::MachineError;
use clap::builder::PossibleValue;
use miette::{IntoDiagnostic, Result, bail, miette};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Arguments of `evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Simulator to run on, `exec:PROGRAM ARG…` or `model:MODEL.toml`, the machine that a diagnosis describes; the default is the built-in plant of the board.
    #[arg(long)]
    plant: Option<String>,
    /// Board file; the default is the paper twin.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Calibration file; by default the gains are first identified from zero.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Gains file.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// Model saved by `gap diagnose --save`, through which the arms `diagnosed` and `closed` are fed forward. Without it,
    /// `diagnosed` records and diagnoses a log of its own and `closed` uses the nominal model.
    #[arg(long, value_name = "MODEL.toml", conflicts_with_all = ["sweep", "ablate"])]
    feedforward: Option<PathBuf>,
    /// Write the result as JSON to this file (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write the result as one HTML page with charts.
    #[arg(long)]
    html: Option<PathBuf>,
    /// Write the charts as one SVG drawing.
    #[arg(long)]
    svg: Option<PathBuf>,
    /// Arms to run; by default all five, and none with --track.
    #[arg(long, value_delimiter = ',')]
    arms: Option<Vec<Arm>>,
    /// Path to drive in closed loop (CSV: t_s, bend_deg, dir_deg and, if wanted, len_mm), after a move to its first point.
    #[arg(long, value_name = "FILE")]
    track: Option<PathBuf>,
    /// With --track: each point of the path becomes known only at its time, as from a joystick.
    #[arg(long, requires = "track")]
    live: bool,
    /// Seed of the built-in plant; selects the simulated unit and its noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Instead of the arms: the closed loop and the best open loop over conditions, with the paper's calibration unless
    /// another is given; exit code 1 if a row fails.
    #[arg(long, conflicts_with_all = ["plant", "html", "arms", "ablate", "track"])]
    sweep: bool,
    /// With --sweep: only the conditions whose name contains this text.
    #[arg(long, requires = "sweep", value_name = "TEXT")]
    only: Option<String>,
    /// Instead of the arms: the closed loop with each of its mechanisms off in turn.
    #[arg(long, conflicts_with_all = ["plant", "html", "svg", "arms", "track"])]
    ablate: bool,
}

impl clap::ValueEnum for Arm {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }
    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()))
    }
}

/// Closed-loop bend RMSE above which the command exits with 1, degrees.
const GOOD_ENOUGH_DEG: f64 = 1.5;
/// RMSE along a path, after its delay, above which the command exits with 1, degrees.
const FOLLOWED_DEG: f64 = 3.0;

/// Runs the command.
///
/// # Errors
/// A report that says what was wrong with the input or the plant.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    check(args)?;
    let board = inputs::board(args.board.as_deref())?;
    let gains = inputs::gains(args.gains.as_deref())?;
    if args.sweep || args.ablate {
        let request = studies::Request {
            sweep: args.sweep,
            only: args.only.as_deref(),
            calib: args.calib.as_deref(),
            json: args.json.as_deref(),
            svg: args.svg.as_deref(),
            seed: args.seed,
        };
        return studies::run(&request, &built_in(args, &board)?, &board, &gains);
    }
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let plant = Plant::new(args, &board)?;
    let _logging = matches!(plant, Plant::Foreign { .. }).then(logging::start);
    let identify = calibration.is_none();
    let calibration = calibration.unwrap_or_default();
    let given = args.feedforward.as_deref();
    let feedforward = inputs::feedforward(given, args.calib.as_deref(), &calibration);
    let feedforward = feedforward
        .map(|path| inputs::described(&path, &board))
        .transpose()?;
    let config = assemble(&board, &calibration, &gains);
    let track = track(args, &config)?;
    let usual = || {
        if track.is_some() {
            Vec::new()
        } else {
            Arm::ALL.to_vec()
        }
    };
    let arms = args.arms.clone().unwrap_or_else(usual);
    let rig = gap::input::rig(args.board.as_deref())?;
    let plan = Plan {
        identify,
        config,
        arms,
        track,
        seed: args.seed,
        rig,
        feedforward,
    };
    let bar = output::bar(0, "{msg:<18} {pos} states held,");
    let result = evaluation::run(&plan, &mut |purpose| plant.open(purpose), &mut |what| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    });
    bar.finish_and_clear();
    let result = result.into_diagnostic()?;
    output::json(args.json.as_deref(), &result)?;
    if let Some(path) = &args.html {
        output::write(path, pictures::html(&result))?;
    }
    if let Some(path) = &args.svg {
        output::write(path, pictures::svg(&result))?;
    }
    output::show(&summary(&result), args.json.as_deref());
    if let Some(warning) = result.track.as_ref().and_then(too_fast) {
        eprintln!("warning: {warning}");
    }
    Ok(verdict(&result))
}

/// Refuses contradictory arguments before anything runs.
fn check(args: &Args) -> Result<()> {
    let arms = args.arms.as_deref().unwrap_or_default();
    for (n, arm) in arms.iter().enumerate() {
        if arms[..n].contains(arm) {
            bail!("--arms names `{}` twice; name each arm once", arm.name());
        }
    }
    let Args {
        json,
        html,
        svg,
        board,
        calib,
        gains,
        feedforward,
        track,
        ..
    } = args;
    let results = [("--json", json), ("--html", html), ("--svg", svg)];
    let results = results.map(|(option, path)| (option, path.as_deref()));
    let inputs = [board, calib, gains, feedforward, track].into_iter();
    let inputs: Vec<&Path> = inputs.filter_map(|p| p.as_deref()).collect();
    output::check(&results, &inputs)
}

/// The path of `--track`, within the reach of the machine as far as it is known before an identification.
fn track(args: &Args, config: &LoopConfig) -> Result<Option<Track>> {
    let Some(file) = &args.track else {
        return Ok(None);
    };
    let path = path::PathFile::open(file, &config.geometry).into_diagnostic()?;
    path.within(&config.limits, &config.geometry, &config.lines)
        .into_diagnostic()?;
    Ok(Some(Track {
        path,
        live: args.live,
    }))
}

/// What is to be said of a path that the pistons cannot follow as it is.
fn too_fast(t: &TrackResult) -> Option<String> {
    let demand = t.demand;
    let done = match t.live {
        true => "a live path is not slowed down, so the tip falls behind",
        false => "it was driven that much slower",
    };
    (demand > 1.0).then(|| {
        format!("the path asks {demand:.2} times the speed that the pistons can follow; {done}")
    })
}

/// The plant that the arms run on.
enum Plant {
    Foreign {
        program: String,
        args: Vec<String>,
    },
    BuiltIn {
        section: Box<PlantSection>,
        seed: u64,
    },
    Described {
        machine: Arc<DescribedMachine>,
        step_mm: f64,
        seed: u64,
    },
}

impl Plant {
    fn new(args: &Args, board: &Board) -> Result<Self> {
        if let Some(path) = args.plant.as_deref().and_then(|p| p.strip_prefix("model:")) {
            let machine = inputs::described(Path::new(path), board)?;
            return Ok(Self::Described {
                machine,
                step_mm: board.drive.law().step_mm,
                seed: args.seed,
            });
        }
        if let Some(plant) = &args.plant {
            let (program, args) = inputs::program(plant)?;
            return Ok(Self::Foreign { program, args });
        }
        Ok(Self::BuiltIn {
            section: Box::new(built_in(args, board)?),
            seed: args.seed,
        })
    }

    fn open(&self, purpose: Purpose) -> Result<Box<dyn World>, MachineError> {
        Ok(match self {
            Self::Foreign { program, args } => Box::new(Link::start(program, args)?),
            Self::Described {
                machine,
                step_mm,
                seed,
            } => Box::new(Described::new(
                machine.as_ref().clone(),
                *step_mm,
                seed.wrapping_add(noise_of(purpose)),
            )),
            Self::BuiltIn { section, seed } => Box::new(Sim::new(
                &section.make(),
                *seed,
                noise_of(purpose),
                section.period_s,
            )?),
        })
    }
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

fn verdict(e: &Evaluation) -> CommandOutcome {
    let bad = |a: &ArmResult| a.bend_rmse_deg > GOOD_ENOUGH_DEG;
    let lost = |t: &TrackResult| t.rmse_delayed_deg > FOLLOWED_DEG;
    let failed = e.track.as_ref().is_some_and(lost) || e.arm(Arm::Closed).is_some_and(bad);
    CommandOutcome::from(e.converged && !failed)
}

/// The table of arms and the gains, for people.
fn summary(e: &Evaluation) -> String {
    let gains = |g: &[f64; 3]| g.map(|x| format!("{x:.2}")).join(", ");
    let origin = match (e.iterations, e.converged) {
        (0, _) => "from the calibration file".to_owned(),
        (n, true) => format!("Algorithm 1, {n} passes"),
        (n, false) => format!("Algorithm 1, NOT converged after {n} passes"),
    };
    // a figure a row, so that the table is narrow
    let mut rows = pictures::arm_rows(e);
    let names = Arm::ALL.into_iter().filter(|arm| e.arm(*arm).is_some());
    for (row, arm) in rows.iter_mut().zip(names) {
        arm.name().clone_into(&mut row[0]);
    }
    let line = |c: usize, title: &str| {
        std::iter::once(title.to_owned())
            .chain(rows.iter().map(|r| r[c].clone()))
            .collect::<Vec<_>>()
    };
    let header = line(0, "");
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let figures = pictures::ARM_COLUMNS
        .iter()
        .enumerate()
        .skip(1)
        .map(|(c, title)| line(c, title));
    let arms = match e.arms.len() {
        0 => String::new(),
        _ => format!("{}\n", output::table(&header, 1..header.len(), figures)),
    };
    let foretold = match e.foretold.len() {
        0 => String::new(),
        _ => {
            let deg = |x: f64| format!("{x:.1}°");
            let row = |f: &Foretold| {
                [
                    f.name.clone(),
                    deg(f.machine_deg),
                    deg(f.twin_deg),
                    deg(f.nominal_deg),
                ]
            };
            let header = [
                "bend RMSE, open loop",
                "machine",
                "its twin foretells",
                "nominal model foretells",
            ];
            format!(
                "{}\n",
                output::table(&header, 1..header.len(), e.foretold.iter().map(row))
            )
        }
    };
    let path = e.track.as_ref().map_or(String::new(), |t| {
        format!(
            "path of {:.1} s: RMSE {:.2}°, 95 % {:.2}°, at most {:.2}°; delay {:.3} s, RMSE after it {:.2}°\n",
            t.duration_s, t.rmse_deg, t.p95_deg, t.max_deg, t.delay_s, t.rmse_delayed_deg
        )
    });
    let (plant, seed, k_eps, k_lambda) = (&e.plant, e.seed, gains(&e.k_eps), gains(&e.k_lambda_mm));
    format!(
        "plant {plant}, seed {seed}\n\n{arms}\n{foretold}{path}k_ε = {k_eps}   k_λ = {k_lambda} mm   ({origin})\n"
    )
}
