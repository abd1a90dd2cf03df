//! `retroflex evaluate`: the paper's experiment on a plant; `--sweep` and `--ablate`: studies on the built-in plant.

use crate::cli::{ResultFile, gap, inputs, logging, output};
use crate::config::{Board, Calibration, Gains, LoopConfig, PlantSection, assemble, source};
use crate::experiment::ablation::{self, AblationRow, MECHANISMS};
use crate::experiment::arm::ArmResult;
use crate::experiment::evaluation::{self, Arm, Evaluation, Plan, Purpose, Track};
use crate::experiment::path;
use crate::experiment::sweep::{self, CONDITIONS, Condition, Study, SweepRow};
use crate::experiment::track::TrackResult;
use crate::report::{evaluation as pictures, sweep as envelope};
use crate::simulation::described::Described;
use crate::simulation::link::Link;
use crate::simulation::sim::Sim;
use crate::simulation::world::World;
use crate::supervisor::MachineError;
use clap::builder::PossibleValue;
use miette::{IntoDiagnostic, Result, bail, miette};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Closed-loop bend RMSE above which the command exits with 1, degrees.
const GOOD_ENOUGH_DEG: f64 = 1.5;
/// RMSE along a path, after its delay, above which the command exits with 1, degrees.
const FOLLOWED_DEG: f64 = 3.0;

/// Units of a row of the sweep, and of the ablation.
const SWEEP_UNITS: u64 = 5;
const ABLATION_UNITS: u64 = 1;

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
    json: Option<ResultFile>,
    /// Write the result as one HTML page with charts.
    #[arg(long)]
    html: Option<ResultFile>,
    /// Write the charts as one SVG drawing.
    #[arg(long)]
    svg: Option<ResultFile>,
    /// Arms to run; by default all five, and none with --track.
    #[arg(long, value_delimiter = ',')]
    arms: Option<Vec<Arm>>,
    /// Path to drive in closed loop (CSV: t_s, bend_deg, dir_deg and, if wanted, len_mm), after a move to its first point.
    #[arg(long, value_name = "FILE")]
    track: Option<PathBuf>,
    /// With --track: each point of the path becomes known only at its time, as from a joystick.
    #[arg(long, requires = "track", conflicts_with_all = ["sweep", "ablate"])]
    live: bool,
    /// Seed of the built-in plant, which selects the simulated unit and its noise. A described machine (`model:`) takes its noise from
    /// it, a simulator (`exec:`) nothing.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Instead of the arms: the closed loop and the best open loop over conditions, with the paper's calibration unless
    /// another is given; exit code 1 if a row fails.
    #[arg(long, group = "study", conflicts_with_all = ["plant", "html", "arms", "ablate", "track"])]
    sweep: bool,
    /// With --sweep or --ablate: only the conditions whose name contains this text.
    #[arg(long, requires = "study", value_name = "TEXT")]
    only: Option<String>,
    /// Instead of the arms: the closed loop with each of its mechanisms off in turn, over the conditions of --sweep.
    #[arg(long, group = "study", conflicts_with_all = ["plant", "html", "svg", "arms", "track"])]
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
        return study(args, &board, &gains);
    }
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let open = plant(args, &board)?;
    let is_foreign = args
        .plant
        .as_deref()
        .is_some_and(|plant| plant.starts_with("exec:"));
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

/// The plant that the arms run on.
fn plant(args: &Args, board: &Board) -> Result<Open> {
    let (seed, foreign) = (args.seed, args.plant.as_deref());
    if let Some(path) = foreign.and_then(|plant| plant.strip_prefix("model:")) {
        let machine = inputs::described(Path::new(path), board)?;
        let step_mm = board.drive.law().step_mm;
        return Ok(Box::new(move |purpose| {
            let noise = seed.wrapping_add(noise_of(purpose));
            let machine = machine.as_ref().clone();
            Ok(Box::new(Described::new(machine, step_mm, noise)))
        }));
    }
    if let Some(plant) = foreign {
        let (program, args) = inputs::program(plant)?;
        return Ok(Box::new(move |_| {
            Ok(Box::new(Link::start(&program, &args)?))
        }));
    }
    let section = built_in(args, board)?;
    Ok(Box::new(move |purpose| {
        let sim = Sim::new(&section, seed, noise_of(purpose), section.period_s)?;
        Ok(Box::new(sim))
    }))
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

/// Runs a study on the built-in plant of a board.
fn study(args: &Args, board: &Board, gains: &Gains) -> Result<bool> {
    let study = Study {
        config: assemble(board, &inputs::calibration(args.calib.as_deref())?, gains),
        make: built_in(args, board)?,
        seed: args.seed,
        units: if args.sweep {
            SWEEP_UNITS
        } else {
            ABLATION_UNITS
        },
    };
    let only = args.only.as_deref().unwrap_or_default();
    let mut conditions: Vec<Condition> = CONDITIONS.to_vec();
    conditions.retain(|c| c.name.contains(only));
    if conditions.is_empty() {
        let names = CONDITIONS.map(|c| c.name).join(", ");
        bail!("--only {only}: no condition has a name that contains this text; there are {names}");
    }
    if args.sweep {
        run_sweep(args, &study, &conditions)
    } else {
        run_ablation(args, &study, &conditions).map(|()| true)
    }
}

fn run_sweep(args: &Args, study: &Study, conditions: &[Condition]) -> Result<bool> {
    let start = Instant::now();
    let rows = sweep::rows(conditions).len() as u64;
    let bar = output::bar(rows * study.units, "units,");
    let rows = sweep::run(study, conditions, &|| bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let result = json!({ "seed": study.seed, "units": study.units, "sweep": rows });
    output::write_some(&args.svg, || Ok(envelope::svg(&rows)))?;
    let (failed, all) = (rows.iter().filter(|r| !r.ok).count(), rows.len());
    let header = "condition|value|open|closed|95 %|hunting|cold|";
    let table = output::table(header, 1..7, rows.iter().map(sweep_row));
    let (units, directions) = (study.units, sweep::DIRECTIONS);
    let (took_s, with) = (start.elapsed().as_secs_f64(), with_calibration(args));
    let text = format!(
        "{table}\n{failed} of {all} rows fail; {units} units each, {directions} of 12 directions; {with} (in {took_s:.0} s)\n"
    );
    output::answer(&args.json, &result, text)?;
    Ok(failed == 0)
}

fn sweep_row(r: &SweepRow) -> Vec<String> {
    vec![
        r.condition.to_owned(),
        r.value.to_string(),
        pictures::deg(r.open_deg),
        pictures::deg(r.closed_deg),
        pictures::deg(r.p95_deg),
        pictures::deg(r.hunting_deg),
        pictures::deg(r.cold_deg),
        if r.ok { "" } else { "FAILS" }.to_owned(),
    ]
}

fn run_ablation(args: &Args, study: &Study, conditions: &[Condition]) -> Result<()> {
    let each = sweep::rows(conditions).len();
    let all = (MECHANISMS.len() * each) as u64 * study.units;
    let bar = output::bar(all, "units,");
    let rows = ablation::run(study, &MECHANISMS, conditions, &|| bar.inc(1)).into_diagnostic()?;
    bar.finish_and_clear();
    let result = json!({ "seed": study.seed, "units": study.units, "ablate": rows });
    let header = "without|RMSE|ratio|to 1°|never|needed most by|ratio";
    let table = output::table(header, 1..5, rows.iter().map(ablation_row));
    let (units, with) = (study.units, with_calibration(args));
    let text = format!("{table}\nclosed loop, {each} conditions, {units} units each, {with}\n");
    output::answer(&args.json, &result, text)
}

fn ablation_row(r: &AblationRow) -> Vec<String> {
    let (condition, value, most) = r.needed;
    vec![
        r.without.to_owned(),
        format!("{:.3}°", r.bend_rmse_deg),
        format!("{:.2}", r.ratio),
        pictures::settle(r.settle_s_median),
        r.unsettled.to_string(),
        format!("{condition} {value}"),
        format!("{most:.2}"),
    ]
}

fn with_calibration(args: &Args) -> String {
    match &args.calib {
        Some(path) => format!("calibration {}", path.display()),
        None => "the paper's calibration for every unit".to_owned(),
    }
}
