//! `retroflex gap check`: a saved model on a fresh log.

use crate::cli::gap::input;
use crate::cli::{ResultFile, output};
use crate::diagnosis::tip::{Checked, Judgement, check};
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
    json: Option<ResultFile>,
}

/// Checks and writes.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<bool> {
    let model = input::saved(&args.model)?;
    let log = input::observe(&args.log, &input::rig(args.board.as_deref())?)?;
    let checked = check(&model, &log);
    output::answer(&args.json, &checked, said(&checked))?;
    Ok(checked.judgement == Judgement::ThisMachine)
}

/// The judgement in one sentence, then the figures.
fn said(c: &Checked) -> String {
    let sentence = match c.judgement {
        Judgement::ThisMachine => "The model fits this machine.",
        Judgement::AnotherUnit => {
            "The model is of another unit, or the gains of this one have changed: diagnose a log of it."
        }
        Judgement::WorseThanNothing => {
            "The model does worse than nothing here: its effects are no longer there. Diagnose the machine again."
        }
    };
    let (before, after, closed, refitted) =
        (c.before_deg, c.after_deg, c.closed * 100.0, c.refitted_deg);
    let left_out = c.left_out.iter();
    let left_out = left_out.map(|name| format!("{name} happens once and is left out\n"));
    format!(
        "{sentence}\nbefore {before:.2}°, after {after:.2}°, closed {closed:.0} %; with gains identified anew {refitted:.2}°\n{}",
        left_out.collect::<String>()
    )
}
