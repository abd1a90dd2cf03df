//! `retroflex gap …`: the commands about the gap between model and machine, and what they share.

use crate::cli::CommandOutcome;
use crate::cli::gap_diagnose::{self, DiagnoseArgs};
use crate::cli::gap_excite::{self, ExciteArgs};
use crate::cli::output;
use crate::config::source;
use crate::diagnosis::observe::Observed;
use crate::diagnosis::saved::SavedModel;
use crate::log::bend_log;
use crate::model::effects::catalogue;
use crate::model::transmission::Line;
use miette::{IntoDiagnostic, Result, miette};
use std::path::{Path, PathBuf};

/// Subcommands of `gap`.
#[derive(Debug, clap::Subcommand)]
pub enum Gap {
    /// Say where the gap of a log lies, which effect causes it and how far it shrinks.
    Diagnose(DiagnoseArgs),
    /// Apply a saved model to a fresh log of the same unit.
    Check(CheckArgs),
    /// Design a schedule on which effects can be told apart.
    Excite(ExciteArgs),
    /// Examine the diagnosis on logs of the built-in plant whose labels it does not see.
    Exam(crate::cli::exam::Args),
}

/// Arguments of `gap check`.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// Model kept by `gap diagnose --save`.
    model: PathBuf,
    /// Fresh bend log of the same unit.
    log: PathBuf,
    /// Write the result as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// Runs a subcommand.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(command: &Gap) -> Result<CommandOutcome> {
    match command {
        Gap::Diagnose(args) => gap_diagnose::run(args),
        Gap::Check(args) => run_check(args),
        Gap::Excite(args) => gap_excite::run(args),
        Gap::Exam(args) => crate::cli::exam::run(args),
    }
}

/// The paper's gains: where recalibration starts when no calibration is given.
pub const PAPER: [Line; 3] =
    [Line { k_epsilon: 2.22, k_lambda_mm: 0.87 }, Line { k_epsilon: 2.53, k_lambda_mm: 0.92 }, Line { k_epsilon: 2.21, k_lambda_mm: 0.81 }];

/// Reads a bend log and makes it ready; one warning names the columns that are not known.
///
/// # Errors
/// A report that names file, line and column, or says what to record instead.
pub fn observe(path: &Path) -> Result<Observed> {
    let log = bend_log::read(path).into_diagnostic()?;
    let observed = Observed::new(&log).map_err(|e| miette!("{}: {e}", path.display()))?;
    if !log.ignored.is_empty() {
        eprintln!("warning: {}: columns ignored: {}", path.display(), log.ignored.join(", "));
    }
    Ok(observed)
}

/// Reads a saved model and checks its names against the catalogue.
///
/// # Errors
/// A report that names file and key.
pub fn saved(path: &Path) -> Result<SavedModel> {
    let model: SavedModel = source::read(path)?;
    match model.unknown_names(&catalogue()) {
        Some(problem) => Err(miette!("{}: {problem}", path.display())),
        None => Ok(model),
    }
}

fn run_check(args: &CheckArgs) -> Result<CommandOutcome> {
    output::check(&[("--json", args.json.as_deref())], &[&args.model, &args.log])?;
    let model = saved(&args.model)?;
    let checked = model.check_on(&observe(&args.log)?, &catalogue());
    eprintln!("before {:.2}°, after {:.2}°, closed {:.0} %", checked.before_deg, checked.after_deg, checked.closed * 100.0);
    output::json(args.json.as_deref(), &checked)?;
    Ok(CommandOutcome::Good)
}
