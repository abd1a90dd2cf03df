//! One row of the report.

use serde::Serialize;

/// One fault and its result.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FaultResult {
    /// Name of the fault.
    pub fault: String,
    /// Time from the injection to the first detection, s; `null` without one.
    pub detected_s: Option<f64>,
    /// Microsteps of all channels after the detection, until everything is settled.
    pub steps_after: i64,
    /// Microsteps that are allowed.
    pub steps_allowed: i64,
    /// Final state.
    pub state: String,
    /// Largest distance of the true bend from the set-point during the fault, degrees.
    pub error_deg_during: f64,
    /// Error of the first pose after the repair, degrees.
    pub error_deg_after: f64,
    /// Message for the operator.
    pub message: String,
    /// What the row requires, in words.
    pub requires: String,
    /// Every requirement was met.
    pub ok: bool,
    /// The requirements that were not met.
    pub why: String,
}

impl FaultResult {
    /// A row without a failure, and what it requires.
    pub fn new(fault: &str, requires: impl Into<String>) -> Self {
        Self {
            fault: fault.to_owned(),
            requires: requires.into(),
            ok: true,
            ..Self::default()
        }
    }

    /// With its final state.
    pub fn ending(mut self, state: &str) -> Self {
        state.clone_into(&mut self.state);
        self
    }

    /// Adds a failure.
    pub fn fail(&mut self, why: impl AsRef<str>) {
        self.ok = false;
        if !self.why.is_empty() {
            self.why.push_str("; ");
        }
        self.why.push_str(why.as_ref());
    }
}

/// Adds a failure to a row unless a condition is met: `require!(row: condition; "why not, as for format!")`.
macro_rules! require {
    ($row:ident: $met:expr; $($why:tt)+) => {
        let met: bool = $met;
        if !met {
            $row.fail(format!($($why)+));
        }
    };
}
pub(crate) use require;
