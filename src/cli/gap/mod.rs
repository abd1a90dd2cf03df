//! `retroflex gap …`: the gap between model and machine.

pub mod apply;
pub mod check;
pub mod compare;
pub mod diagnose;
pub mod exam;
pub mod excite;
pub mod input;
pub mod map;
pub mod rows;

use crate::cli::CommandOutcome;
use miette::Result;

/// Subcommands of `gap`.
#[derive(Debug, clap::Subcommand)]
pub enum Gap {
    /// Locate the gap of a log, name the effect that causes it, and state how much of it the effect closes.
    Diagnose(diagnose::Args),
    /// Apply a saved model to a fresh log of the same unit.
    Check(check::Args),
    /// Drive your own simulator with the pistons of a log, and state how far it is from the log.
    Compare(compare::Args),
    /// Write what a calibration file can hold of a saved model.
    Apply(apply::Args),
    /// Design a schedule that separates effects.
    Excite(excite::Args),
    /// Test the diagnosis on logs of the built-in plant with hidden labels.
    Exam(exam::Args),
}

/// Runs a subcommand.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(command: &Gap) -> Result<CommandOutcome> {
    match command {
        Gap::Diagnose(args) => diagnose::run(args),
        Gap::Check(args) => check::run(args),
        Gap::Compare(args) => compare::run(args),
        Gap::Apply(args) => apply::run(args),
        Gap::Excite(args) => excite::run(args),
        Gap::Exam(args) => exam::run(args),
    }
}
