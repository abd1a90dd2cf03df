//! `retroflex gap …`: diagnose a bend log, check a saved model on a fresh one.

use crate::cli::Outcome;
use crate::cli::gap_excite::{self, ExciteArgs};
use crate::cli::output::write;
use crate::config::calib::Calibration;
use crate::config::source;
use crate::effects::{Effect, catalogue};
use crate::gap::diagnose::{Diagnosis, diagnose};
use crate::gap::observe::Observed;
use crate::gap::saved::SavedModel;
use crate::log::bend_log;
use crate::model::transmission::Line;
use comfy_table::{CellAlignment, Table, presets};
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
}

/// Arguments of `gap diagnose`.
#[derive(Debug, clap::Args)]
pub struct DiagnoseArgs {
    /// Bend log, *.csv or *.csv.gz.
    log: PathBuf,
    /// Calibration the log was driven with.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// Write the diagnosis as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Keep the recalibrated and the explained model for `gap check`.
    #[arg(long)]
    save: Option<PathBuf>,
    /// Seed of the block bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
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
pub fn run(command: &Gap) -> Result<Outcome> {
    match command {
        Gap::Diagnose(args) => run_diagnose(args),
        Gap::Check(args) => run_check(args),
        Gap::Excite(args) => gap_excite::run(args),
    }
}

/// The paper's gains: where recalibration starts when no calibration is given.
pub const PAPER: [Line; 3] =
    [Line { k_epsilon: 2.22, k_lambda_mm: 0.87 }, Line { k_epsilon: 2.53, k_lambda_mm: 0.92 }, Line { k_epsilon: 2.21, k_lambda_mm: 0.81 }];

fn observe(path: &Path) -> Result<Observed> {
    let log = bend_log::read(path).into_diagnostic()?;
    if !log.ignored.is_empty() {
        eprintln!("warning: {}: columns ignored: {}", path.display(), log.ignored.join(", "));
    }
    Observed::new(&log).map_err(|e| miette!("{}: {e}", path.display()))
}

fn run_diagnose(args: &DiagnoseArgs) -> Result<Outcome> {
    let calibration: Option<Calibration> = args.calib.as_deref().map(source::read).transpose()?;
    let lines = calibration.map_or(PAPER, |c| c.lines());
    let observed = observe(&args.log)?;
    let catalogue = catalogue();
    let done = diagnose(&observed, &catalogue, &lines, args.seed);
    eprintln!("{}", summary(&done.document));
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&done.document).into_diagnostic()?;
        write(path, &(text + "\n"))?;
    }
    if let Some(path) = &args.save {
        let saved =
            SavedModel::new(&args.log.display().to_string(), &catalogue, &done.found, &done.chosen, &done.document.verdict.equivalent);
        write(path, &toml::to_string(&saved).into_diagnostic()?)?;
    }
    Ok(Outcome::Good)
}

fn run_check(args: &CheckArgs) -> Result<Outcome> {
    let saved: SavedModel = source::read(&args.model)?;
    let catalogue: Vec<Box<dyn Effect>> = catalogue();
    if let Some(problem) = saved.unknown_names(&catalogue) {
        return Err(miette!("{}: {problem}", args.model.display()));
    }
    let checked = saved.check_on(&observe(&args.log)?, &catalogue);
    eprintln!("before {:.2}°, after {:.2}°, closed {:.0} %", checked.before_deg, checked.after_deg, checked.closed * 100.0);
    if let Some(path) = &args.json {
        write(path, &(serde_json::to_string(&checked).into_diagnostic()? + "\n"))?;
    }
    Ok(Outcome::Good)
}

fn summary(d: &Diagnosis) -> String {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["effect", "stage", "probability", "gap before", "after", "closed", "95 %"]);
    for e in d.effects.iter().take(6) {
        table.add_row([
            e.name.to_owned(),
            e.stage.to_owned(),
            format!("{:.2}", e.probability),
            format!("{:.2}°", e.gap_before_deg),
            format!("{:.2}°", e.gap_after_deg),
            format!("{:.0} %", e.closed * 100.0),
            format!("{:.0} to {:.0} %", e.closed_ci95[0] * 100.0, e.closed_ci95[1] * 100.0),
        ]);
    }
    for column in table.column_iter_mut().skip(2) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    let g = &d.gap;
    let names = if d.verdict.names.is_empty() { String::new() } else { format!(": {}", d.verdict.names.join(" and ")) };
    let twins: String = d.verdict.equivalent.iter().map(|t| format!("\nnot distinguishable here: {}", t.join(", "))).collect();
    format!(
        "gap {:.2}° as configured, {:.2}° recalibrated, {:.2}° explained, {:.2}° noise\n{table}\nverdict {}{names}{twins}",
        g.as_configured_deg, g.recalibrated_deg, g.explained_deg, g.noise_floor_deg, d.verdict.kind
    )
}
