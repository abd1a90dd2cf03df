//! `retroflex gap apply`: writes what a calibration file can hold of a saved model, and says what it cannot.

use crate::cli::calibrate::today;
use crate::cli::gap::input;
use crate::cli::{CommandOutcome, output};
use crate::config::{Calibration, DynamicsSection, TransmissionSection};
use crate::diagnosis::tip::{Remedy, SavedModel};
use crate::estimation::imu_calibration::Entry;
use crate::model::effects::{Effect, by_name};
use crate::report::gap::words::plain;
use miette::{IntoDiagnostic, Result};
use std::path::{Path, PathBuf};

/// Largest and least lag of a calibration file, s.
const LAG_S: [f64; 2] = [0.001, 2.0];
/// Largest dead time of a calibration file, s.
const DELAY_MAX_S: f64 = 0.6;

/// Arguments of `gap apply`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model saved by `gap diagnose --save`.
    model: PathBuf,
    /// Calibration file to write; without it, the command only says what it would hold.
    #[arg(long, value_name = "OUT.toml")]
    calib: Option<PathBuf>,
}

/// Where an effect goes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    Calibration,
    Feedforward,
    Nowhere(&'static str),
}

/// Writes the calibration.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    output::check(&[("--calib", args.calib.as_deref())], &[&args.model])?;
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
        let text =
            toml::to_string_pretty(&calibration(&model, &args.model, path)?).into_diagnostic()?;
        output::write(path, &text)?;
    }
    output::show(&(said(&model, &effects, args) + "\n"), None);
    Ok(CommandOutcome::Good)
}

/// What becomes of the gains and of each effect, after a sentence that says what the verdict asks for.
fn said(model: &SavedModel, effects: &[Box<dyn Effect>], args: &Args) -> String {
    let verdict: Vec<String> = effects
        .iter()
        .filter(|e| model.effect.iter().any(|s| s.name == e.name()))
        .map(|e| format!("{}: {}", plain(e.name()), Remedy::of(e.as_ref()).advice()))
        .collect();
    let mut out = vec![if verdict.is_empty() {
        "The verdict names no effect; the recalibrated gains are all there is to apply.".to_owned()
    } else {
        format!("The verdict asks for this: {}.", verdict.join("; "))
    }];
    out.extend(
        args.calib
            .as_ref()
            .map(|p| format!("written to {}", p.display())),
    );
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

fn place(model: &SavedModel, e: &dyn Effect) -> Place {
    let proven = model.effect.iter().any(|s| s.name == e.name());
    match Remedy::of(e) {
        Remedy::Mend => Place::Nowhere("which happens once and cannot be predicted"),
        Remedy::Calibrate if proven => Place::Calibration,
        Remedy::Calibrate if e.sensing_only() => Place::Nowhere("which the verdict does not name"),
        Remedy::Estimate => Place::Nowhere("which drifts: the service estimates it while it runs"),
        Remedy::Motors => {
            Place::Nowhere("which `retroflex calibrate imu motors` identifies from the same log")
        }
        Remedy::Calibrate | Remedy::Feedforward => Place::Feedforward,
    }
}

/// The calibration that a model implies.
fn calibration(model: &SavedModel, path: &Path, out: &Path) -> Result<Calibration> {
    let value = |name: &str| {
        by_name(name)
            .filter(|e| place(model, e.as_ref()) == Place::Calibration)
            .and_then(|e| Some((model.params_of(e.as_ref())?, e)))
    };
    let date = today();
    let entry = |name: &str, unit: fn(f64) -> f64| {
        let (values, e) = value(name)?;
        // the model file states no intervals; the prior of the catalogue bounds them
        let of = |f: &dyn Fn(usize) -> f64| [0, 1, 2].map(|k| unit(f(k)));
        Some(Entry {
            value: of(&|k| values[k]),
            sigma: of(&|k| e.params()[k].scale),
            date: date.clone(),
            source: model.source.clone(),
        })
    };
    let line_lag = by_name("line_lag")
        .and_then(|e| model.params_of(e.as_ref()))
        .map_or(0.0, |p| (p[0] + p[1] + p[2]) / 3.0);
    let late: f64 = ["transport_delay", "sensor_latency"]
        .iter()
        .filter_map(|n| value(n))
        .map(|(p, _)| p[0])
        .sum();
    let usual = DynamicsSection::default();
    let mut calibration = Calibration {
        feedforward: beside(path, out)?,
        transmission: TransmissionSection {
            k_epsilon: model.nominal.k_epsilon,
            k_lambda_mm: model.nominal.k_lambda_mm,
            date: date.clone(),
            source: model.source.clone(),
            ..TransmissionSection::default()
        },
        dynamics: DynamicsSection {
            lag_s: (model.nominal.lag_s + line_lag).clamp(LAG_S[0], LAG_S[1]),
            delay_s: (usual.delay_s + late).min(DELAY_MAX_S),
            ..usual
        },
        ..Calibration::default()
    };
    calibration.imu.acc_bias_m_s2 = entry("accel_bias", |x| x);
    calibration.imu.mag_bias_ut = entry("hard_iron", |x| x);
    calibration.imu.mount_deg = entry("mount_misalignment", f64::to_degrees);
    Ok(calibration)
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
