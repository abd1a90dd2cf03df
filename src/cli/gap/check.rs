//! `retroflex gap check`: a saved model on a fresh log.

use crate::cli::gap::input;
use crate::cli::{CommandOutcome, output};
use crate::model::effects::catalogue;
use miette::Result;
use std::path::PathBuf;

/// Arguments of `gap check`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model saved by `gap diagnose --save`.
    model: PathBuf,
    /// Fresh bend log of the same unit.
    log: PathBuf,
    /// Board file of the machine; default: the machine of the paper.
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Write the result as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// Checks and writes.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut inputs = vec![args.model.as_path(), args.log.as_path()];
    inputs.extend(args.board.as_deref());
    output::check(&[("--json", args.json.as_deref())], &inputs)?;
    let model = input::saved(&args.model)?;
    let checked = model.check_on(
        &input::observe(&args.log, &input::rig(args.board.as_deref())?)?,
        &catalogue(),
    );
    eprintln!(
        "before {:.2}°, after {:.2}°, closed {:.0} %",
        checked.before_deg,
        checked.after_deg,
        checked.closed * 100.0
    );
    for name in &checked.left_out {
        eprintln!("{name} happens once and is left out");
    }
    output::json(args.json.as_deref(), &checked)?;
    Ok(CommandOutcome::Good)
}
