//! `retroflex imu score`: an orientation filter against a recording with a reference.

use crate::cli::{CommandOutcome, output};
use crate::estimation::fusion::FilterName;
use crate::estimation::score;
use miette::{IntoDiagnostic, Result};
use std::path::PathBuf;

/// Subcommands of `imu`.
#[derive(Debug, clap::Subcommand)]
pub enum Imu {
    /// Run a filter over recordings and print total, heading and inclination RMSE.
    Score(ScoreArgs),
}

/// Arguments of `imu score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// Recordings, *.csv or *.csv.gz.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Filter to run; without it the best one.
    #[arg(long, conflicts_with = "all")]
    filter: Option<FilterName>,
    /// Every filter over every file.
    #[arg(long)]
    all: bool,
    /// Write the rows as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// Runs a subcommand.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(command: &Imu) -> Result<CommandOutcome> {
    let Imu::Score(args) = command;
    let rows = score::run(&args.files, args.filter, args.all).into_diagnostic()?;
    eprintln!("{}", score::table(&rows));
    if let Some(path) = &args.json {
        output::write(path, &(serde_json::to_string_pretty(&rows).into_diagnostic()? + "\n"))?;
    }
    Ok(CommandOutcome::Good)
}
