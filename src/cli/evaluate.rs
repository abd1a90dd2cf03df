//! `retroflex evaluate`: the paper's experiment on a plant.

use crate::cli::{CommandOutcome, output};
use crate::config::board::{Board, PlantSection};
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::{assemble, source};
use crate::experiment::arm::ArmResult;
use crate::experiment::evaluation::{self, Arm, Evaluation, Plan, Purpose};
use crate::report::evaluation as pictures;
use crate::simulation::link::{self, Link};
use crate::simulation::sim::Sim;
use crate::simulation::world::World;
use crate::supervisor::machine::MachineError;
use clap::builder::PossibleValue;
use comfy_table::{CellAlignment, Table, presets};
use miette::{IntoDiagnostic, Result, miette};
use std::io::Write;
use std::path::{Path, PathBuf};

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
    /// Write the result as one HTML page with charts.
    #[arg(long)]
    html: Option<PathBuf>,
    /// Write the charts alone as one SVG drawing.
    #[arg(long)]
    svg: Option<PathBuf>,
    /// Arms to run.
    #[arg(long, value_delimiter = ',', default_value = "none,extension,backlash,closed")]
    arms: Vec<Arm>,
    /// Seed of the built-in plant: which unit of its make, and its noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

impl clap::ValueEnum for Arm {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }
    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name()))
    }
}

/// Closed-loop bend RMSE above which the run answers "not good enough", degrees.
const GOOD_ENOUGH_DEG: f64 = 1.5;

/// Runs the command.
///
/// # Errors
/// A report that says what was wrong with the input or the plant.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    check(args)?;
    let board: Board = match &args.board {
        Some(path) => source::read(path)?,
        None => source::parse("boards/sim.toml", include_str!("../../boards/sim.toml"))?,
    };
    let gains: Gains = match &args.gains {
        Some(path) => source::read(path)?,
        None => source::parse("boards/gains.toml", include_str!("../../boards/gains.toml"))?,
    };
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let plant = Choice::of(args, &board)?;
    let plan = Plan {
        identify: calibration.is_none(),
        config: assemble(&board, &calibration.unwrap_or_default(), &gains),
        arms: args.arms.clone(),
        seed: args.seed,
    };
    let bar = output::bar(0, "{msg:<18} {pos} states held,");
    let result = evaluation::run(&plan, &mut |purpose| plant.open(purpose), &mut |what| {
        bar.set_message(what.to_owned());
        bar.inc(1);
    });
    bar.finish_and_clear();
    let result = result.into_diagnostic()?;
    write_all(args, &result)?;
    show(&result);
    Ok(verdict(&result))
}

/// Refuses arguments that contradict each other, before anything is run.
fn check(args: &Args) -> Result<()> {
    for (n, arm) in args.arms.iter().enumerate() {
        if args.arms[..n].contains(arm) {
            return Err(miette!("--arms names `{}` twice; name each arm once", arm.name()));
        }
    }
    let files: Vec<&Path> = [&args.json, &args.html, &args.svg].into_iter().flatten().map(PathBuf::as_path).collect();
    for (n, path) in files.iter().enumerate() {
        output::check(path)?;
        if files[..n].contains(path) {
            return Err(miette!("{}: named for two results at once; give each its own file", path.display()));
        }
    }
    Ok(())
}

/// Which plant the arms run on.
enum Choice {
    Foreign { program: String, args: Vec<String> },
    BuiltIn { section: Box<PlantSection>, seed: u64 },
}

impl Choice {
    fn of(args: &Args, board: &Board) -> Result<Self> {
        if let Some(plant) = &args.plant {
            let line = plant.strip_prefix("exec:").ok_or_else(|| miette!("--plant `{plant}`: expected `exec:PROGRAM ARG…`"))?;
            let mut words = link::words(line).map_err(|why| miette!("--plant `{plant}`: {why}"))?.into_iter();
            let program = words.next().ok_or_else(|| miette!("--plant `{plant}`: no program is named after `exec:`"))?;
            return Ok(Self::Foreign { program, args: words.collect() });
        }
        let section = board.plant.clone().ok_or_else(|| {
            let name = args.board.as_ref().map_or_else(|| "boards/sim.toml".to_owned(), |b| b.display().to_string());
            miette!("{name} has no [plant] table, so there is nothing to run on; give --plant 'exec:PROGRAM ARG…' or a board that describes a plant")
        })?;
        Ok(Self::BuiltIn { section: Box::new(section), seed: args.seed })
    }

    fn open(&self, purpose: Purpose) -> Result<Box<dyn World>, MachineError> {
        Ok(match self {
            Self::Foreign { program, args } => Box::new(Link::start(program, args)?),
            Self::BuiltIn { section, seed } => Box::new(Sim::new(&section.make(), *seed, noise_of(purpose), section.period_s)?),
        })
    }
}

/// Every run has noise of its own, the same whichever other arms are asked for.
fn noise_of(purpose: Purpose) -> u64 {
    match purpose {
        Purpose::Identify => 0,
        Purpose::Arm(arm) => 1 + arm as u64,
    }
}

fn verdict(e: &Evaluation) -> CommandOutcome {
    let bad = |a: &ArmResult| a.bend_rmse_deg > GOOD_ENOUGH_DEG;
    if !e.converged || e.arm(Arm::Closed).is_some_and(bad) { CommandOutcome::NotGoodEnough } else { CommandOutcome::Good }
}

fn write_all(args: &Args, e: &Evaluation) -> Result<()> {
    if let Some(path) = &args.json {
        output::write(path, &(serde_json::to_string_pretty(e).into_diagnostic()? + "\n"))?;
    }
    if let Some(path) = &args.html {
        output::write(path, &pictures::html(e))?;
    }
    if let Some(path) = &args.svg {
        output::write(path, &pictures::svg(e))?;
    }
    Ok(())
}

/// The table and what stands under it, on stdout.
fn show(e: &Evaluation) {
    let gains = |g: &[f64; 3]| g.map(|x| format!("{x:.2}")).join(", ");
    let origin = match (e.iterations, e.converged) {
        (0, _) => "from the calibration file".to_owned(),
        (n, true) => format!("Algorithm 1, {n} passes"),
        (n, false) => format!("Algorithm 1, NOT converged after {n} passes"),
    };
    let text = format!(
        "plant {}, seed {}\n{}\nk_ε = {}   k_λ = {} mm   ({origin})\n",
        e.plant,
        e.seed,
        table(e),
        gains(&e.k_eps),
        gains(&e.k_lambda_mm)
    );
    // a reader that has gone away (`| head`) is no failure of the evaluation
    let _ = std::io::stdout().write_all(text.as_bytes());
}

fn table(e: &Evaluation) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["arm", "bend RMSE", "orientation RMSE", "felt − true", "median to 1°", "moves at most", "states", "held by a wall"]);
    for a in &e.arms {
        table.add_row([
            a.name.clone(),
            format!("{:.2}°", a.bend_rmse_deg),
            format!("{:.2}°", a.orientation_rmse_deg),
            format!("{:.2}°", a.estimate_rmse_deg),
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
