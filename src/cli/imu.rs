//! `retroflex imu score`: orientation filters against recordings with a reference.

use crate::cli::{CommandOutcome, output};
use crate::estimation::fusion::FilterName;
use crate::estimation::score;
use miette::{IntoDiagnostic, Result};
use std::path::{Path, PathBuf};

/// Subcommands of `imu`.
#[derive(Debug, clap::Subcommand)]
pub enum Imu {
    /// Run filters over recordings and print the RMSE of the rotation, its heading and its inclination.
    Score(ScoreArgs),
}

/// Arguments of `imu score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// Recordings, *.csv or *.csv.gz.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Filter to run; the default is the most accurate one.
    #[arg(long, conflicts_with = "all")]
    filter: Option<FilterName>,
    /// Run every filter on every file.
    #[arg(long)]
    all: bool,
    /// Write the rows as JSON to this file (`-`: standard output).
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Runs a subcommand.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(command: &Imu) -> Result<CommandOutcome> {
    let Imu::Score(args) = command;
    let inputs: Vec<&Path> = args.files.iter().map(PathBuf::as_path).collect();
    output::check(&[("--json", args.json.as_deref())], &inputs)?;
    let rows = score::run(&args.files, args.filter, args.all).into_diagnostic()?;
    eprintln!("{}", score::table(&rows));
    for row in rows
        .iter()
        .filter(|row| row.filter == rows[0].filter && row.saturated > 0.0)
    {
        eprintln!(
            "{}: the gyroscope is at the end of its range in {:.1} % of the samples, so rates are too small there; record with a larger range or move more slowly",
            row.file,
            100.0 * row.saturated
        );
    }
    output::json(args.json.as_deref(), &rows)?;
    Ok(CommandOutcome::Good)
}
