//! The diagnosis of a mapped rig as a document.

use crate::diagnosis::rig::file::MapFile;
use crate::diagnosis::tip::document::VerdictEntry;
use serde::Serialize;

/// RMSE in the unit of the output.
#[derive(Debug, Clone, Serialize, Default)]
pub struct Figures {
    /// Nominal model, on held-out blocks.
    pub recalibrated: f64,
    /// With the verdict's effects, on held-out blocks.
    pub explained: f64,
    /// White noise of a row.
    pub noise_floor: f64,
}

/// A nonlinear parameter of an effect.
#[derive(Debug, Clone, Serialize)]
pub struct Parameter {
    /// Effect.
    pub of: &'static str,
    /// Meaning.
    pub name: &'static str,
    /// Value; times in s (rows without a clock), periods in the unit of the moving signal.
    pub value: f64,
}

/// An effect, or the whole set of the verdict.
#[derive(Debug, Clone, Serialize)]
pub struct Entry {
    /// Name.
    pub name: String,
    /// Probability that the effect is present; for a set, that its effects are present and no others.
    pub probability: f64,
    /// RMSE without it.
    pub rmse_before: f64,
    /// RMSE with it.
    pub rmse_after: f64,
    /// Part of the gap that it closes.
    pub closed: f64,
    /// 95 % interval of that part.
    pub closed_ci95: [f64; 2],
    /// Parameters.
    pub params: Vec<Parameter>,
}

/// The unexplained remainder.
#[derive(Debug, Clone, Serialize, Default)]
pub struct Left {
    /// Probability that a cause that the operators lack is present.
    pub probability: f64,
    /// RMSE left above the noise.
    pub rmse: f64,
}

/// The fitted model on another log of the rig.
#[derive(Debug, Clone, Serialize)]
pub struct Fresh {
    /// Name of the log.
    pub log: String,
    /// RMSE of the nominal model.
    pub before: f64,
    /// RMSE with the effects.
    pub after: f64,
}

/// The whole diagnosis.
#[derive(Debug, Clone, Serialize, Default)]
pub struct Document {
    /// Version of this document.
    pub schema: u32,
    /// `map`: a rig described by a map file.
    pub rig: &'static str,
    /// Unit of all errors.
    pub unit: String,
    /// The gap.
    pub gap: Figures,
    /// The verdict's set as a whole; empty for a verdict without effects.
    pub set: Vec<Entry>,
    /// Every single effect, most probable first.
    pub effects: Vec<Entry>,
    /// Unexplained remainder.
    pub unknown: Left,
    /// The verdict.
    pub verdict: VerdictEntry,
    /// What this log cannot show, regardless of the scores.
    pub notes: Vec<String>,
    /// The fitted model on other logs.
    pub fresh: Vec<Fresh>,
}

impl Document {
    /// The document of a log that does not determine the nominal model: its verdict is `unknown`.
    pub fn empty(map: &MapFile) -> Self {
        Self {
            schema: 1,
            rig: "map",
            unit: map.output_unit.clone(),
            unknown: Left { probability: 1.0, rmse: 0.0 },
            notes: vec![
                "the inputs do not determine the nominal model: they move together or not at all. Record them one by one".to_owned(),
            ],
            ..Self::default()
        }
    }
}
