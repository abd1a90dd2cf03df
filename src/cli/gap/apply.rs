//! `retroflex gap apply`: writes what a calibration file can hold of a saved model, and says what it cannot.

use crate::cli::calibrate::{existing, today};
use crate::cli::{ResultFile, inputs, output};
use crate::config::{Calibration, DynamicsSection, TransmissionSection};
use crate::diagnosis::tip::{Remedy, SavedModel};
use crate::estimation::imu_calibration::Entry;
use crate::model::effects::{Effect, by_name};
use crate::report::gap::words::plain;
use miette::{IntoDiagnostic, Result, miette};
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
    /// Calibration file to write; without it, the command only says what it would hold. Of a calibration that exists, the name of the
    /// tip and the errors of the IMU that the model does not know are kept, comments are not.
    #[arg(long, value_name = "OUT.toml")]
    calib: Option<ResultFile>,
}

/// Writes the calibration.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<()> {
    let model = inputs::tip_model(&args.model)?;
    let forecast = model.forecast.iter().flat_map(|f| &f.effect);
    let mut effects: Vec<&'static dyn Effect> = Vec::new();
    for saved in model.effect.iter().chain(forecast) {
        if !effects.iter().any(|e| e.name() == saved.name) {
            effects.extend(by_name(&saved.name));
        }
    }
    if let Some(path) = &args.calib {
        let old = existing(path)?.try_into();
        let old: Calibration = old.map_err(|e| miette!("{}: {e}", path.display()))?;
        let calibration = calibration(&model, old, beside(&args.model, path)?, &today());
        let text = toml::to_string_pretty(&calibration).into_diagnostic()?;
        output::write(path, text)?;
    }
    output::print(said(&model, &effects, args) + "\n");
    Ok(())
}

/// What becomes of the gains and of each effect, after a sentence that says what the verdict asks for.
fn said(model: &SavedModel, effects: &[&'static dyn Effect], args: &Args) -> String {
    let mut verdict = Vec::new();
    for e in effects.iter().filter(|e| is_proven(model, **e)) {
        let advice = Remedy::of(*e).advice();
        verdict.push(format!("{}: {advice}", plain(e.name())));
    }
    let mut out = vec![if verdict.is_empty() {
        "The verdict names no effect; the recalibrated gains are all there is to apply.".to_owned()
    } else {
        format!("The verdict asks for this: {}.", verdict.join("; "))
    }];
    let calib = args.calib.as_deref();
    out.extend(calib.map(|path| format!("written to {}", path.display())));
    let source = &model.source;
    out.push(format!(
        "calibration: k_epsilon and k_lambda as re-identified on {source}"
    ));
    out.extend(effects.iter().map(|e| match place(model, *e) {
        Place::Calibration => format!("calibration: {}", e.name()),
        Place::Feedforward => format!("feedforward through {}: {}", args.model.display(), e.name()),
        Place::Nowhere(why) => format!("not held: {}, {why}", e.name()),
    }));
    out.join("\n")
}

/// Whether the verdict of a model names an effect.
fn is_proven(model: &SavedModel, e: &dyn Effect) -> bool {
    model.effect.iter().any(|saved| saved.name == e.name())
}

/// The path of the model as the calibration names it: the file name in the same folder, the whole path otherwise.
fn beside(model: &Path, out: &Path) -> Result<String> {
    let model = std::path::absolute(model).into_diagnostic()?;
    let out = std::path::absolute(out).into_diagnostic()?;
    let folder = out.parent();
    let near = folder.and_then(|folder| model.strip_prefix(folder).ok());
    Ok(near.unwrap_or(&model).display().to_string())
}

/// Where an effect goes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    /// Into the calibration file.
    Calibration,
    /// Into the feedforward through the model.
    Feedforward,
    /// Nowhere, with the reason.
    Nowhere(&'static str),
}

/// Where an effect of a model goes.
fn place(model: &SavedModel, e: &dyn Effect) -> Place {
    match Remedy::of(e) {
        Remedy::Mend => Place::Nowhere("which happens once and cannot be predicted"),
        Remedy::Calibrate if is_proven(model, e) => Place::Calibration,
        Remedy::Calibrate if e.sensing_only() => Place::Nowhere("which the verdict does not name"),
        Remedy::Estimate => Place::Nowhere("which drifts: the service estimates it while it runs"),
        Remedy::Motors => {
            Place::Nowhere("which `retroflex calibrate imu motors` identifies from the same log")
        }
        Remedy::Calibrate | Remedy::Feedforward => Place::Feedforward,
    }
}

/// The calibration that a model implies, for the tip and the IMU of `old`. `feedforward` is the path of the model as the calibration
/// names it, `date` that of today.
fn calibration(
    model: &SavedModel,
    old: Calibration,
    feedforward: String,
    date: &str,
) -> Calibration {
    let value = |name: &str| {
        let e = by_name(name).filter(|e| place(model, *e) == Place::Calibration)?;
        Some((model.params_of(e)?, e))
    };
    let entry = |name: &str, unit: fn(f64) -> f64| {
        let (values, e) = value(name)?;
        // the model file states no intervals; the prior of the catalogue bounds them
        let of = |f: &dyn Fn(usize) -> f64| [0, 1, 2].map(|k| unit(f(k)));
        Some(Entry {
            value: of(&|k| values[k]),
            sigma: of(&|k| e.params()[k].scale),
            date: date.to_owned(),
            source: model.source.clone(),
        })
    };
    let line_lag = by_name("line_lag").and_then(|e| model.params_of(e));
    let line_lag = line_lag.map_or(0.0, |p| (p[0] + p[1] + p[2]) / 3.0);
    let late = ["transport_delay", "sensor_latency"].into_iter();
    let late: f64 = late.filter_map(value).map(|(p, _)| p[0]).sum();
    let usual = DynamicsSection::default();
    let mut calibration = Calibration {
        feedforward,
        transmission: TransmissionSection {
            k_epsilon: model.nominal.k_epsilon,
            k_lambda_mm: model.nominal.k_lambda_mm,
            tip: old.transmission.tip,
            date: date.to_owned(),
            source: model.source.clone(),
            ..TransmissionSection::default()
        },
        dynamics: DynamicsSection {
            lag_s: (model.nominal.lag_s + line_lag).clamp(LAG_S[0], LAG_S[1]),
            delay_s: (usual.delay_s + late).min(DELAY_MAX_S),
            ..usual
        },
        imu: old.imu,
    };
    let imu = &mut calibration.imu;
    imu.acc_bias_m_s2 = entry("accel_bias", |x| x).or(imu.acc_bias_m_s2.take());
    imu.mag_bias_ut = entry("hard_iron", |x| x).or(imu.mag_bias_ut.take());
    imu.mount_deg = entry("mount_misalignment", f64::to_degrees).or(imu.mount_deg.take());
    calibration
}
