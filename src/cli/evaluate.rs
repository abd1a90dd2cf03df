//! `retroflex evaluate`: the paper's experiment on a plant.

use crate::cli::{Outcome, write_whole};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::{assemble, source};
use crate::control::pi::Dynamics;
use crate::experiment::arm::{self, ArmResult};
use crate::experiment::identify::{self, Identified};
use crate::experiment::rig::Rig;
use crate::experiment::schedule::paper;
use crate::link::Link;
use crate::model::drive::Drive;
use crate::model::transmission::Line;
use crate::tick::Config;
use crate::world::World;
use comfy_table::{CellAlignment, Table, presets};
use indicatif::{ProgressBar, ProgressStyle};
use miette::{IntoDiagnostic, Result, miette};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `evaluate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Plant to run on: `exec:PROGRAM ARG…`; without it the built-in plant of the board.
    #[arg(long)]
    plant: Option<String>,
    /// Board file; without it the paper twin.
    #[arg(long)]
    board: Option<PathBuf>,
    /// Calibration file; without it the gains are identified first, from zero.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Gains file.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// Write the result as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Arms to run, of none, extension, backlash, closed.
    #[arg(long, value_delimiter = ',', default_values_t = [Arm::None, Arm::Extension, Arm::Backlash, Arm::Closed])]
    arms: Vec<Arm>,
    /// Seed of the built-in plant's unit and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What is compensated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Arm {
    /// Kinematics alone.
    None,
    /// Kinematics and extension.
    Extension,
    /// Kinematics, extension and backlash.
    Backlash,
    /// All of it inside the orientation loop.
    Closed,
}

impl std::fmt::Display for Arm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::None => "none",
            Self::Extension => "extension",
            Self::Backlash => "backlash",
            Self::Closed => "closed",
        })
    }
}

#[derive(Serialize)]
struct Report {
    plant: String,
    seed: u64,
    arms: Vec<ArmResult>,
    k_eps: [f64; 3],
    k_lambda_mm: [f64; 3],
    lag_s: f64,
    delay_s: f64,
    iterations: usize,
    converged: bool,
    history: Vec<[[f64; 2]; 3]>,
}

/// Closed-loop bend RMSE above which the run answers "not good enough", degrees.
const GOOD_ENOUGH_DEG: f64 = 1.5;

/// Runs the command.
///
/// # Errors
/// A report that says what was wrong with the input or the plant.
pub fn run(args: &Args) -> Result<Outcome> {
    let (board, gains) = (read_board(args)?, read_gains(args)?);
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let bar = progress();
    let (lines, dynamics, found, name) = match &calibration {
        Some(c) => (c.lines(), c.dynamics.law(), None, String::new()),
        None => {
            let mut world = open(args, &board)?;
            let config = config_for(&assemble(&board, &Calibration::default(), &gains), world.as_ref());
            bar.set_message("identify");
            let found = identify::algorithm_1(&config, world.as_mut(), &paper(), &mut |_| bar.inc(1)).into_diagnostic()?;
            (found.lines(), found.dynamics, Some(found), world.nature().name.clone())
        }
    };
    let base = Config { lines, dynamics, ..assemble(&board, &calibration.unwrap_or_default(), &gains) };
    let mut report = empty_report(args, &base, found.as_ref(), name);
    for arm in &args.arms {
        bar.set_message(arm.to_string());
        let mut world = open(args, &board)?;
        report.plant.clone_from(&world.nature().name);
        let config = arm_config(*arm, &config_for(&base, world.as_ref()));
        let result = arm::run(&arm.to_string(), &mut Rig::new(config, world.as_mut()), &paper(), &mut || bar.inc(1)).into_diagnostic()?;
        report.arms.push(result);
    }
    bar.finish_and_clear();
    eprintln!("{}", table(&report));
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    Ok(verdict(&report))
}

fn verdict(report: &Report) -> Outcome {
    let bad = |a: &ArmResult| a.name == "closed" && a.bend_rmse_deg > GOOD_ENOUGH_DEG;
    if !report.converged || report.arms.iter().any(bad) { Outcome::NotGoodEnough } else { Outcome::Good }
}

fn read_board(args: &Args) -> Result<Board> {
    Ok(match &args.board {
        Some(path) => source::read(path)?,
        None => source::parse("boards/sim.toml", include_str!("../../boards/sim.toml"))?,
    })
}

fn read_gains(args: &Args) -> Result<Gains> {
    Ok(match &args.gains {
        Some(path) => source::read(path)?,
        None => source::parse("boards/gains.toml", include_str!("../../boards/gains.toml"))?,
    })
}

fn open(args: &Args, _board: &Board) -> Result<Box<dyn World>> {
    match &args.plant {
        Some(plant) => {
            let line = plant.strip_prefix("exec:").ok_or_else(|| miette!("--plant `{plant}`: expected `exec:PROGRAM ARG…`"))?;
            let mut words = line.split_whitespace().map(str::to_owned);
            let program = words.next().ok_or_else(|| miette!("--plant `{plant}`: no program is named after `exec:`"))?;
            let rest: Vec<String> = words.collect();
            Ok(Box::new(Link::start(&program, &rest).into_diagnostic()?))
        }
        None => Err(miette!("no built-in plant yet")),
    }
}

/// The plant's own step and rest length take the board's place.
fn config_for(config: &Config, world: &dyn World) -> Config {
    let nature = world.nature();
    let mut config = config.clone();
    config.drive = Drive { step_mm: nature.step_mm };
    config.geometry.rest_length_mm = nature.rest_length_mm;
    config
}

fn arm_config(arm: Arm, base: &Config) -> Config {
    let zero = Line { k_epsilon: 0.0, k_lambda_mm: 0.0 };
    let lines = match arm {
        Arm::None => [zero; 3],
        Arm::Extension => base.lines.map(|l| Line { k_lambda_mm: 0.0, ..l }),
        Arm::Backlash | Arm::Closed => base.lines,
    };
    let feedback = if arm == Arm::Closed { base.feedback } else { None };
    Config { lines, feedback, ..base.clone() }
}

fn empty_report(args: &Args, base: &Config, found: Option<&Identified>, plant: String) -> Report {
    let Dynamics { lag_s, delay_s } = base.dynamics;
    Report {
        plant,
        seed: args.seed,
        arms: Vec::new(),
        k_eps: base.lines.map(|l| l.k_epsilon),
        k_lambda_mm: base.lines.map(|l| l.k_lambda_mm),
        lag_s,
        delay_s,
        iterations: found.map_or(0, |f| f.history.len() - 1),
        converged: found.is_none_or(|f| f.converged),
        history: found.map_or(Vec::new(), |f| f.history.iter().map(|ls| ls.map(|l| [l.k_epsilon, l.k_lambda_mm])).collect()),
    }
}

fn progress() -> ProgressBar {
    // draws on stderr, and only where that is a terminal
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg:<10} {pos} states held, {elapsed}") {
        bar.set_style(style);
    }
    bar
}

fn table(report: &Report) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["arm", "bend RMSE", "orientation RMSE", "felt − true", "settled (median)", "moves at most", "states", "held by a wall"]);
    for a in &report.arms {
        table.add_row([
            a.name.clone(),
            format!("{:.2}°", a.bend_rmse_deg),
            format!("{:.2}°", a.orientation_rmse_deg),
            format!("{:.2}°", a.felt_rmse_deg),
            format!("{:.2} s", a.settle_s_median),
            format!("{:.2}°", a.peak_to_peak_max_deg),
            a.states.to_string(),
            a.blocked.to_string(),
        ]);
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn write_json(path: &std::path::Path, report: &Report) -> Result<()> {
    write_whole(path, &(serde_json::to_string_pretty(report).into_diagnostic()? + "\n"))
}
