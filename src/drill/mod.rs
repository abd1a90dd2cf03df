//! Drills: every fault the project claims to survive, put into a tip in mid-motion.
//!
//! A row is one fault. The built-in plant flies through the same pilot, gate and memory as the service;
//! in the middle of a move the fault strikes; then it is measured how long it took until something was
//! noticed, how many microsteps still went out, in which state it came to rest and what was said.
//! Then the cause is mended, the operator's way back is gone, and the error of the next pose is
//! measured against the plant's truth. Faults of the process are put into real child processes.
//!
//! * [`mod@bench`]: a pilot on a machine that can be broken; [`list`]: the rows; [`run`]: one flight.
//! * [`process`]: kills, stops, disks, clients. [`soak`]: hours of random commands and faults.

pub mod bench;
pub mod list;
pub mod process;
pub mod run;
pub mod soak;

use serde::Serialize;

/// One fault and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The fault.
    pub fault: String,
    /// From the fault to the first thing that noticed it, s; `null` if nothing did.
    pub detected_s: Option<f64>,
    /// Microsteps that went out after that, all channels, until it was settled.
    pub steps_after: i64,
    /// … of which this many are allowed.
    pub steps_allowed: i64,
    /// State it came to.
    pub state: String,
    /// Largest distance of the true bend from the set-point while the fault lasted, degrees.
    pub error_deg_during: f64,
    /// Error of the first pose after it was mended, degrees.
    pub error_deg_after: f64,
    /// What the operator was told.
    pub message: String,
    /// All that was promised held.
    pub ok: bool,
    /// What did not, if anything.
    pub why: String,
}

impl Row {
    /// A row about a process, which has no bend to be wrong.
    #[must_use]
    pub fn process(fault: &str, detected_s: Option<f64>, state: &str, message: String) -> Self {
        Self {
            fault: fault.to_owned(),
            detected_s,
            steps_after: 0,
            steps_allowed: 0,
            state: state.to_owned(),
            error_deg_during: 0.0,
            error_deg_after: 0.0,
            message,
            ok: true,
            why: String::new(),
        }
    }

    /// Adds something that did not hold.
    pub fn fail(&mut self, why: impl AsRef<str>) {
        self.ok = false;
        if !self.why.is_empty() {
            self.why.push_str("; ");
        }
        self.why.push_str(why.as_ref());
    }

    /// Demands something.
    pub fn demand(&mut self, holds: bool, why: impl FnOnce(&Self) -> String) {
        if !holds {
            let why = why(self);
            self.fail(why);
        }
    }
}
