//! `retroflex imu score`: orientation filters against recordings with a reference.

use crate::cli::{CommandOutcome, output};
use crate::estimation::fusion::FilterName;
use crate::estimation::score::{self, Row, Score};
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
    output::show(&format!("{}\n", table(&rows)), args.json.as_deref());
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

/// A line for each recording and filter, and the means of several recordings.
fn table(rows: &[Row]) -> String {
    let line = |file: &str, filter: FilterName, s: &Score| {
        let figures = [s.total_deg, s.heading_deg, s.inclination_deg].map(|x| format!("{x:.2}"));
        let [total, heading, inclination] = figures;
        [
            file.to_owned(),
            filter.to_string(),
            total,
            heading,
            inclination,
        ]
    };
    let mut lines: Vec<_> = rows
        .iter()
        .map(|row| line(&row.file, row.filter, &row.score))
        .collect();
    if rows.iter().any(|row| row.file != rows[0].file) {
        let means = |filter| Some(line("mean", filter, &score::mean(rows, filter)?));
        lines.extend(FilterName::ALL.into_iter().filter_map(means));
    }
    let header = ["° RMS", "filter", "total", "heading", "inclination"];
    output::table(&header, 2..5, lines).to_string()
}
