//! The diagnosis as a document. `docs/gap.md` describes the JSON form.

use crate::diagnosis::tip::credit::StageShare;
use crate::diagnosis::tip::observed::quantity::PerQuantity;
use crate::diagnosis::verdict::decide::VerdictKind;
use crate::diagnosis::verdict::posterior::Posterior;
use serde::Serialize;

/// The gap, degrees RMS over the logged quantities.
#[derive(Debug, Clone, Serialize)]
pub struct Gap {
    /// With the calibration as given.
    pub as_configured_deg: f64,
    /// After recalibration, on left-out blocks.
    pub recalibrated_deg: f64,
    /// With the verdict's effects, on left-out blocks.
    pub explained_deg: f64,
    /// White noise alone.
    pub noise_floor_deg: f64,
}

/// Error in a region of bend and direction.
#[derive(Debug, Clone, Serialize)]
pub struct Region {
    /// Bend, degrees, from and to.
    pub bend_deg: [f64; 2],
    /// Direction, degrees, from and to.
    pub dir_deg: [f64; 2],
    /// RMSE of the recalibrated model, degrees.
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects, degrees.
    pub explained_deg: f64,
}

/// Error in a stretch of time.
#[derive(Debug, Clone, Serialize)]
pub struct When {
    /// Start, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// RMSE of the recalibrated model, degrees.
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects, degrees.
    pub explained_deg: f64,
}

/// Error of one quantity.
#[derive(Debug, Clone, Serialize)]
pub struct QuantityShare {
    /// Name of the quantity.
    pub name: &'static str,
    /// RMSE of the recalibrated model, degrees (°/s for the gyroscope).
    pub rmse_deg: f64,
    /// RMSE with the verdict's effects.
    pub explained_deg: f64,
}

/// Location of the gap.
#[derive(Debug, Clone, Serialize)]
pub struct Location {
    /// Stages, largest share first.
    pub stages: Vec<StageShare>,
    /// Groups of stages that this log cannot separate.
    pub merged: Vec<Vec<&'static str>>,
    /// By bend and direction.
    pub regions: Vec<Region>,
    /// By time.
    pub when: Vec<When>,
    /// By quantity.
    pub kinds: Vec<QuantityShare>,
}

/// A fitted parameter.
#[derive(Debug, Clone, Serialize)]
pub struct ParamValue {
    /// Name.
    pub name: &'static str,
    /// Unit; empty for a plain number.
    pub unit: &'static str,
    /// Estimate.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Channel 1 to 3; 0 if the parameter belongs to none.
    pub channel: u8,
}

/// An effect of the catalogue.
#[derive(Debug, Clone, Serialize)]
pub struct EffectEntry {
    /// Name.
    pub name: &'static str,
    /// Stage.
    pub stage: &'static str,
    /// Probability that the effect is present.
    pub probability: f64,
    /// RMSE without the effect, degrees.
    pub gap_before_deg: f64,
    /// RMSE with the effect, degrees.
    pub gap_after_deg: f64,
    /// Part of the gap that the effect closes.
    pub closed: f64,
    /// 95 % interval of that part.
    pub closed_ci95: [f64; 2],
    /// Parameters.
    pub params: Vec<ParamValue>,
}

/// The verdict.
#[derive(Debug, Clone, Default, Serialize)]
pub struct VerdictEntry {
    /// Kind.
    pub kind: VerdictKind,
    /// Names of the effects.
    pub names: Vec<&'static str>,
    /// Probability of the statement; an effect of a group counts as any other of it.
    pub probability: f64,
    /// Groups of effects that this log cannot separate.
    pub equivalent: Vec<Vec<&'static str>>,
    /// Statements of which one is true in 95 % of all logs, the most probable first.
    pub conformal: Vec<StatementEntry>,
}

/// A statement about a log.
#[derive(Debug, Clone, Serialize)]
pub struct StatementEntry {
    /// Kind.
    pub kind: VerdictKind,
    /// Names of the effects that explain the log.
    pub names: Vec<&'static str>,
    /// Its probability.
    pub probability: f64,
}

impl StatementEntry {
    /// The statements of which one is true with 95 %.
    pub fn conformal(posterior: &Posterior) -> Vec<Self> {
        let entry = |(names, probability): &(Option<Vec<&'static str>>, f64)| Self {
            kind: names.as_ref().map_or(VerdictKind::Unknown, |names| {
                VerdictKind::new(names.is_empty(), false)
            }),
            names: names.clone().unwrap_or_default(),
            probability: *probability,
        };
        posterior
            .ranked
            .iter()
            .take(posterior.conformal)
            .map(entry)
            .collect()
    }
}

/// The unexplained remainder.
#[derive(Debug, Clone, Serialize)]
pub struct UnknownEntry {
    /// Probability that a cause outside the catalogue is present.
    pub probability: f64,
    /// RMSE left above the noise, degrees.
    pub rmse_deg: f64,
    /// What it depends on, the strongest first.
    pub goes_with: Vec<DependenceEntry>,
}

/// Something that the remainder depends on.
#[derive(Debug, Clone, Serialize)]
pub struct DependenceEntry {
    /// What.
    pub name: &'static str,
    /// Part of the remainder's energy in one sensor that it predicts on left-out blocks.
    pub share: f64,
}

/// A set of effects and what it leaves.
#[derive(Debug, Clone, Serialize)]
pub struct Rival {
    /// Names; empty for the nominal model.
    pub names: Vec<&'static str>,
    /// Held-out energy over all quantities, deg².
    pub energy_deg2: f64,
    /// Held-out RMSE: reference, accelerometer, magnetometer (degrees) and gyroscope (°/s).
    pub rmse_deg: PerQuantity<f64>,
    /// Weighted sum of squares in sample.
    pub cost: f64,
}

/// One of the logs that were diagnosed together.
#[derive(Debug, Clone, Serialize)]
pub struct LogEntry {
    /// Name of the file.
    pub file: String,
    /// RMS of its part of the gap after recalibration, on left-out blocks, degrees.
    pub recalibrated_deg: f64,
    /// The same with the verdict's effects.
    pub explained_deg: f64,
}

/// A whole diagnosis.
#[derive(Debug, Clone, Serialize)]
pub struct Diagnosis {
    /// Version of this document.
    pub schema: u32,
    /// Size of the gap.
    pub gap: Gap,
    /// Location of the gap.
    #[serde(rename = "where")]
    pub location: Location,
    /// All effects, most probable first.
    pub effects: Vec<EffectEntry>,
    /// Verdict.
    pub verdict: VerdictEntry,
    /// Unexplained remainder.
    pub unknown: UnknownEntry,
    /// The logs.
    pub logs: Vec<LogEntry>,
    /// Compared sets, best first.
    pub rivals: Vec<Rival>,
}
