//! The diagnosis of a mapped rig as a document.

use crate::diagnosis::map::file::MapFile;
use serde::Serialize;

/// RMSE in the output's unit.
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// Nominal model, on left-out blocks.
    pub recalibrated: f64,
    /// With the verdict's effects.
    pub explained: f64,
    /// White noise of a row.
    pub noise_floor: f64,
}

/// A number that an effect is not linear in.
#[derive(Debug, Clone, Serialize)]
pub struct Parameter {
    /// Effect.
    pub of: &'static str,
    /// What it is.
    pub name: &'static str,
    /// Value; times in s (rows without a clock), periods in the unit of what moves.
    pub value: f64,
}

/// An effect, or the whole set of the verdict.
#[derive(Debug, Clone, Serialize)]
pub struct Entry {
    /// Name.
    pub name: String,
    /// RMSE without it.
    pub rmse_before: f64,
    /// RMSE with it.
    pub rmse_after: f64,
    /// Part of the gap it closes.
    pub closed: f64,
    /// 95 % interval of that part.
    pub closed_ci95: [f64; 2],
    /// Its numbers.
    pub params: Vec<Parameter>,
}

/// The answer.
#[derive(Debug, Clone, Serialize)]
pub struct MapVerdict {
    /// `none`, `effects` or `unknown`.
    pub kind: &'static str,
    /// Names.
    pub names: Vec<&'static str>,
    /// Groups that this log cannot tell apart.
    pub equivalent: Vec<Vec<&'static str>>,
}

/// Another log of the rig.
#[derive(Debug, Clone, Serialize)]
pub struct Fresh {
    /// Its name.
    pub log: String,
    /// RMSE of the nominal model as fitted.
    pub before: f64,
    /// RMSE with the effects as fitted.
    pub after: f64,
}

/// The whole diagnosis.
#[derive(Debug, Clone, Serialize)]
pub struct Document {
    /// Version of this document.
    pub schema: u32,
    /// `map`: a rig described by a map file.
    pub rig: &'static str,
    /// Unit of all errors.
    pub unit: String,
    /// The gap.
    pub gap: Figures,
    /// The verdict's set as a whole; empty if there is none.
    pub set: Vec<Entry>,
    /// Every single effect, most closed first.
    pub effects: Vec<Entry>,
    /// The answer.
    pub verdict: MapVerdict,
    /// What this log cannot show, whatever the scores say.
    pub notes: Vec<String>,
    /// The fitted model on other logs.
    pub fresh: Vec<Fresh>,
}

impl Document {
    /// What is said when not even the nominal model can be fixed.
    #[must_use]
    pub fn empty(map: &MapFile) -> Self {
        Self {
            schema: 1,
            rig: "map",
            unit: map.output_unit.clone(),
            gap: Figures { recalibrated: 0.0, explained: 0.0, noise_floor: 0.0 },
            set: vec![],
            effects: vec![],
            verdict: MapVerdict { kind: "unknown", names: vec![], equivalent: vec![] },
            notes: vec!["the inputs do not fix the nominal model: they move together or not at all. Record them one by one".to_owned()],
            fresh: vec![],
        }
    }
}
