//! What a replay starts from, and what a running supervisor is given besides orders.

use crate::control::{DynamicsPrior, RestartState};
use crate::model::Line;
use crate::service::Belief;
use crate::service::flight::cycle::fnv;
use crate::supervisor::{CycleOutput, MachineInfo};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Longest period, s, and length, mm, of a machine.
const PERIOD_MAX_S: f64 = 10.0;
const LENGTH_MAX_MM: f64 = 1000.0;

/// Names of the texts of a [`Header`].
pub const TEXTS: [&str; 4] = [
    "board.toml",
    "gains.toml",
    "calibration.toml",
    "feedforward.toml",
];

/// A freshly reset supervisor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the log: 3.
    pub log: u32,
    /// Number of the first cycle of this supervisor.
    pub cycle: u64,
    /// Version of the program that wrote it.
    pub program: String,
    /// Hash of the texts.
    pub config_hash: String,
    /// Board, gains, calibration, resolved, and, with a feedforward, its model.
    pub texts: Vec<String>,
    /// The machine.
    pub machine: MachineInfo,
    /// Identity of the mounted tip.
    pub tip: String,
    /// Gains of channels 1 to 3 at the start.
    pub lines: [Line; 3],
    /// Lag and dead time at the start.
    pub dynamics: DynamicsPrior,
    /// State that the supervisor started from.
    pub restart: Option<RestartState>,
    /// Trust in the position of that state.
    pub belief: Belief,
    /// No measurement had confirmed the last zero.
    pub unverified: bool,
}

impl Header {
    /// Hash of each configuration text, by its name.
    pub fn hashes(&self) -> BTreeMap<String, String> {
        let hashed = |(name, text)| (format!("{name} hash"), hash([text]));
        self.named_texts().map(hashed).collect()
    }

    /// The configuration texts by name.
    pub fn named_texts(&self) -> impl Iterator<Item = (&'static str, &str)> {
        TEXTS.into_iter().zip(self.texts.iter().map(String::as_str))
    }
}

/// What happened to the supervisor before a cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::large_enum_variant, reason = "there are few of them")]
pub enum Event {
    /// It began afresh.
    Start(Header),
    /// It was given new gains.
    Reload {
        /// The gains file, resolved.
        gains: String,
        /// Gains of channels 1 to 3, which a reload keeps.
        lines: [Line; 3],
    },
    /// It was given a path: times in s, and rows of bend vector in rad and length in mm.
    Path(Vec<f64>, Vec<Vector3<f64>>),
}

impl Event {
    /// True if a machine can have these values.
    pub fn is_possible(&self) -> bool {
        let within = |x: f64, max: f64| x > 0.0 && x <= max;
        match self {
            Self::Start(header) => {
                within(header.machine.period_s, PERIOD_MAX_S)
                    && within(header.machine.step_mm, LENGTH_MAX_MM)
                    && within(header.machine.rest_length_mm, LENGTH_MAX_MM)
                    && DynamicsPrior::is_possible_s(header.dynamics.expected.lag_s)
                    && DynamicsPrior::is_possible_s(header.dynamics.expected.delay_s)
                    && header.restart.is_none_or(|restart| restart.is_possible())
                    && header.lines.iter().all(Line::is_possible)
            }
            Self::Reload { lines, .. } => lines.iter().all(Line::is_possible),
            Self::Path(..) => true,
        }
    }

    /// The event before this cycle.
    pub fn at(&self, cycle: u64) -> Self {
        match self {
            Self::Start(header) => Self::Start(Header {
                cycle,
                ..header.clone()
            }),
            other => other.clone(),
        }
    }
}

/// A cycle on its way into the log.
#[derive(Debug, Clone)]
pub struct Logged {
    /// Number of the cycle since the start of the service.
    pub number: u64,
    /// What happened before it.
    pub events: Vec<Arc<Event>>,
    /// Its output.
    pub output: CycleOutput,
}

/// Hash of texts, in hexadecimal.
pub fn hash<'a>(texts: impl IntoIterator<Item = &'a str>) -> String {
    format!(
        "{:016x}",
        fnv(texts.into_iter().flat_map(|t| t.bytes().chain([0])))
    )
}
