//! The state that survives a restart. [`crate::service::store`] writes it to the disk.

use crate::control::{DynamicsPrior, RestartState};
use crate::model::Line;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::Path;

/// Number of faults in the history.
const FAULTS_MAX: usize = 64;

/// The persistent state.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// Identity of the disposable tip; empty if none was given.
    pub tip: String,
    /// Drivers may have moved the pistons since this was written.
    pub armed: bool,
    /// The position of the pistons was unknown; only `zero` or homing changes that.
    #[serde(default)]
    pub lost: bool,
    /// No measurement has confirmed the last zero.
    #[serde(default)]
    pub unverified: bool,
    /// Positions of pistons and tip, and what was learned.
    #[serde(alias = "kept")]
    pub restart: Option<RestartState>,
    /// The accepted calibration, in use.
    pub accepted: Option<LearnedGains>,
    /// A calibration that awaits acceptance.
    pub proposed: Option<LearnedGains>,
    /// Fault history, oldest first.
    pub faults: Vec<RecordedFault>,
    /// Hash of the configuration in use.
    pub config_hash: String,
}

/// Transmission gains and their origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedGains {
    /// Extension gains k_ε of channels 1 to 3.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths k_λ, mm.
    pub k_lambda_mm: [f64; 3],
    /// Lag, s.
    pub lag_s: f64,
    /// Dead time, s.
    pub delay_s: f64,
    /// Tip that they were identified on.
    pub tip: String,
    /// Time of the identification, seconds since 1970.
    pub unix_s: f64,
    /// Command that identified them.
    pub source: String,
}

impl LearnedGains {
    /// The gains per channel.
    pub fn lines(&self) -> [Line; 3] {
        Line::each(self.k_epsilon, self.k_lambda_mm)
    }
}

/// One entry of the fault history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedFault {
    /// Time, seconds since 1970.
    pub unix_s: f64,
    /// Name of the trip cause.
    pub cause: String,
    /// Message for the operator.
    #[serde(alias = "words")]
    pub message: String,
}

impl Memory {
    /// True if a machine can have these values.
    pub fn is_possible(&self) -> bool {
        let gains = [&self.accepted, &self.proposed];
        let gains = gains.into_iter().flatten().all(|gains| {
            gains.lines().iter().all(Line::is_possible)
                && DynamicsPrior::is_possible_s(gains.lag_s)
                && DynamicsPrior::is_possible_s(gains.delay_s)
        });
        gains && self.restart.is_none_or(|restart| restart.is_possible())
    }

    /// Adds a fault and drops the oldest beyond `FAULTS_MAX`.
    pub fn record_fault(&mut self, fault: RecordedFault) {
        self.faults.push(fault);
        let excess = self.faults.len().saturating_sub(FAULTS_MAX);
        self.faults.drain(..excess);
    }
}

/// Why the memory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MemoryError {
    /// The folder or slot of this path.
    #[error(
        "{0}: {1}; the service must be able to write to its state folder (StateDirectory= in the unit, or `--state`)"
    )]
    Io(String, #[source] io::Error),
    /// Another service holds the lock of this folder.
    #[error(
        "{0}: another retroflex uses this state folder; stop it first, or give `--state` another folder"
    )]
    InUse(String),
    /// Reading it back would give something else.
    #[error("the state contains a value that is not a finite number and was not written")]
    NotFinite,
    /// Larger than a slot.
    #[error("a state of {0} bytes does not fit into its slot")]
    TooLarge(usize),
}

impl MemoryError {
    /// Adds the path to an I/O error.
    pub fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.display().to_string();
        move |reason| Self::Io(path, reason)
    }
}
