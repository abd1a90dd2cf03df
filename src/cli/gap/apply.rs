//! `retroflex gap apply`: writes what a calibration file can hold of a saved model, and says what it cannot.

use crate::cli::calibrate::today;
use crate::cli::gap::from_model::{Place, calibration, place};
use crate::cli::gap::input;
use crate::cli::output::{self, ResultFile};
use crate::diagnosis::tip::{Remedy, SavedModel};
use crate::model::effects::{Effect, by_name};
use crate::report::gap::words::plain;
use miette::{IntoDiagnostic, Result};
use std::path::{Path, PathBuf};

/// Arguments of `gap apply`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model saved by `gap diagnose --save`.
    model: PathBuf,
    /// Calibration file to write; without it, the command only says what it would hold.
    #[arg(long, value_name = "OUT.toml")]
    calib: Option<ResultFile>,
}

/// Writes the calibration.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<()> {
    let model = input::saved(&args.model)?;
    let forecast = model
        .forecast
        .iter()
        .flat_map(|f| &f.effect)
        .map(|e| e.name.as_str());
    let mut effects: Vec<Box<dyn Effect>> = Vec::new();
    for name in model.effect.iter().map(|e| e.name.as_str()).chain(forecast) {
        if !effects.iter().any(|e| e.name() == name) {
            effects.extend(by_name(name));
        }
    }
    if let Some(path) = &args.calib {
        let calibration = calibration(&model, beside(&args.model, path)?, &today());
        output::write(
            path,
            toml::to_string_pretty(&calibration).into_diagnostic()?,
        )?;
    }
    output::print(said(&model, &effects, args) + "\n");
    Ok(())
}

/// What becomes of the gains and of each effect, after a sentence that says what the verdict asks for.
fn said(model: &SavedModel, effects: &[Box<dyn Effect>], args: &Args) -> String {
    let verdict: Vec<String> = effects
        .iter()
        .filter(|e| model.effect.iter().any(|s| s.name == e.name()))
        .map(|e| format!("{}: {}", plain(e.name()), Remedy::of(e.as_ref()).name()))
        .collect();
    let mut out = vec![if verdict.is_empty() {
        "The verdict names no effect; the recalibrated gains are all there is to apply.".to_owned()
    } else {
        format!("The verdict asks for this: {}.", verdict.join("; "))
    }];
    let calib = args.calib.as_deref();
    out.extend(calib.map(|path| format!("written to {}", path.display())));
    out.push(format!(
        "calibration: k_epsilon and k_lambda as re-identified on {}",
        model.source
    ));
    out.extend(effects.iter().map(|e| match place(model, e.as_ref()) {
        Place::Calibration => format!("calibration: {}", e.name()),
        Place::Feedforward => format!("feedforward through {}: {}", args.model.display(), e.name()),
        Place::Nowhere(why) => format!("not held: {}, {why}", e.name()),
    }));
    out.join("\n")
}

/// The path of the model as the calibration names it: the file name in the same folder, the whole path otherwise.
fn beside(model: &Path, out: &Path) -> Result<String> {
    let (model, folder) = (
        std::path::absolute(model).into_diagnostic()?,
        std::path::absolute(out).into_diagnostic()?,
    );
    let near = folder.parent().and_then(|f| model.strip_prefix(f).ok());
    Ok(near.unwrap_or(&model).display().to_string())
}
