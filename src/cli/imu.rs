//! `retroflex imu score`: orientation filters against recordings with a reference.

use crate::cli::{ResultFile, output};
use crate::estimation::fusion::FilterName;
use crate::experiment::score::{self, FileScore, Score};
use miette::{IntoDiagnostic, Result};
use std::path::PathBuf;

commands! {
    /// Subcommands of `imu`.
    pub enum Imu;

    /// Run filters over recordings and print the RMSE of the rotation, its heading and its inclination.
    Score(ScoreArgs) => run,
}

/// Arguments of `imu score`.
#[derive(Debug, clap::Args)]
pub struct ScoreArgs {
    /// IMU recordings with a reference, *.csv or *.csv.gz: time_s, acc_x to acc_z, gyr_x to gyr_z, ref_qw to ref_qz (docs/formats.md). A
    /// bend log is none.
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
    json: Option<ResultFile>,
}

/// Runs a subcommand.
///
/// # Errors
/// A report that names what is wrong with the input.
pub fn run(args: &ScoreArgs) -> Result<()> {
    let rows = score::run(&args.files, args.filter, args.all).into_diagnostic()?;
    output::answer(&args.json, &rows, table(&rows) + "\n")?;
    let saturated = |row: &&FileScore| row.filter == rows[0].filter && row.saturated > 0.0;
    for row in rows.iter().filter(saturated) {
        eprintln!(
            "{}: the gyroscope is at the end of its range in {:.1} % of the samples, so rates are too small there; record with a larger range or move more slowly",
            row.file,
            100.0 * row.saturated
        );
    }
    Ok(())
}

/// A line for each recording and filter, and the means of several recordings.
fn table(rows: &[FileScore]) -> String {
    let line = |file: &str, filter: FilterName, s: &Score| {
        let figures = [s.total_deg, s.heading_deg, s.inclination_deg].map(|x| format!("{x:.2}"));
        [vec![file.to_owned(), filter.to_string()], figures.into()].concat()
    };
    let of = |row: &FileScore| line(&row.file, row.filter, &row.score);
    let mut lines: Vec<_> = rows.iter().map(of).collect();
    if rows.iter().any(|row| row.file != rows[0].file) {
        let means = |filter| Some(line("mean", filter, &score::mean(rows, filter)?));
        lines.extend(FilterName::ALL.into_iter().filter_map(means));
    }
    output::table("° RMS|filter|total|heading|inclination", 2..5, lines).to_string()
}
