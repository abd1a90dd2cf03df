//! What a calibration file can hold of a saved model.

use crate::config::{Calibration, DynamicsSection, TransmissionSection};
use crate::diagnosis::tip::{Remedy, SavedModel};
use crate::estimation::imu_calibration::Entry;
use crate::model::effects::{Effect, by_name};

/// Largest and least lag of a calibration file, s.
const LAG_S: [f64; 2] = [0.001, 2.0];
/// Largest dead time of a calibration file, s.
const DELAY_MAX_S: f64 = 0.6;

/// Where an effect goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// Into the calibration file.
    Calibration,
    /// Into the feedforward through the model.
    Feedforward,
    /// Nowhere, with the reason.
    Nowhere(&'static str),
}

/// Where an effect of a model goes.
pub fn place(model: &SavedModel, e: &dyn Effect) -> Place {
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

/// The calibration that a model implies. `feedforward` is the path of the model as the calibration names it, `date` that of today.
pub fn calibration(model: &SavedModel, feedforward: String, date: &str) -> Calibration {
    let value = |name: &str| {
        by_name(name)
            .filter(|e| place(model, e.as_ref()) == Place::Calibration)
            .and_then(|e| Some((model.params_of(e.as_ref())?, e)))
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
        feedforward,
        transmission: TransmissionSection {
            k_epsilon: model.nominal.k_epsilon,
            k_lambda_mm: model.nominal.k_lambda_mm,
            date: date.to_owned(),
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
    calibration
}
