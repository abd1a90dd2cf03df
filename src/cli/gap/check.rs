//! `retroflex gap check`: a saved model on a fresh log.

use crate::cli::gap::input;
use crate::cli::{ResultFile, inputs, output};
use crate::config::source;
use crate::diagnosis::rig::{self, MapFile, SavedRig};
use crate::diagnosis::tip::check;
use crate::diagnosis::{Checked, Judgement};
use crate::report::gap::words::short;
use miette::{IntoDiagnostic, Result, bail};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Arguments of `gap check`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model saved by `gap diagnose --save`.
    model: PathBuf,
    /// Fresh log of the same unit.
    log: PathBuf,
    /// Map of the columns of the log of another rig. Its model holds the same map, so that this may be left out.
    #[arg(long, value_name = "FILE.toml", conflicts_with = "board")]
    map: Option<PathBuf>,
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
    let file = args.model.display();
    let checked = match (inputs::is_mapped(&args.model)?, &args.map, &args.board) {
        (true, _, None) => check_rig(args)?,
        (true, ..) => bail!(
            "{file}: this is the model of a mapped rig, which has no board; leave --board out"
        ),
        (false, Some(_), _) => bail!(
            "{file}: this is the model of a tip; leave --map out, or give a model that `gap diagnose --map --save` wrote"
        ),
        (false, None, board) => {
            let model = inputs::tip_model(&args.model)?;
            check(
                &model,
                &input::observe(&args.log, &input::rig(board.as_deref())?)?,
            )
        }
    };
    output::answer(&args.json, &document(&checked), said(&checked))?;
    Ok(checked.judgement == Judgement::ThisMachine)
}

/// Checks the model of a mapped rig.
fn check_rig(args: &Args) -> Result<Checked> {
    let model: SavedRig = source::read(&args.model)?;
    if let Some(path) = &args.map {
        let (map, file) = (path.display(), args.model.display());
        if source::read::<MapFile>(path)? != model.map {
            bail!(
                "{map}: differs from the map in {file}; leave --map out, or diagnose with this map"
            );
        }
    }
    let log = input::mapped(&args.log, &model.map, &args.model)?;
    rig::check(&model, &log).into_diagnostic()
}

/// The answer as JSON; keys of degrees say so.
fn document(c: &Checked) -> Value {
    let unit = if c.unit.is_none() { "_deg" } else { "" };
    let mut out =
        json!({"judgement": c.judgement.name(), "closed": c.closed, "left_out": c.left_out});
    for (key, error) in [
        ("before", c.before),
        ("after", c.after),
        ("refitted", c.refitted),
    ] {
        out[format!("{key}{unit}")] = json!(error);
    }
    if let Some(unit) = &c.unit {
        out["unit"] = json!(unit);
    }
    out
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
    // degrees need no more than two decimals, and any other unit three digits
    let error = |x: f64| match &c.unit {
        Some(unit) => format!("{} {unit}", short(x)).trim_end().to_owned(),
        None => format!("{x:.2}°"),
    };
    let [before, after, refitted] = [c.before, c.after, c.refitted].map(error);
    let closed = 100.0 * c.closed;
    let left_out = c.left_out.iter();
    let left_out = left_out.map(|name| format!("{name} happens once and is left out\n"));
    format!(
        "{sentence}\nbefore {before}, after {after}, closed {closed:.0} %; with gains identified anew {refitted}\n{}",
        left_out.collect::<String>()
    )
}
