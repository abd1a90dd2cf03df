//! `retroflex gap …`: the gap between model and machine.

pub mod apply;
pub mod check;
pub mod compare;
pub mod diagnose;
pub mod exam;
pub mod excite;
pub mod input;
pub mod rows;

commands! {
    /// Subcommands of `gap`.
    pub enum Gap;

    /// Locate the gap of a log, name the effect that causes it, and state how much of it the effect closes.
    Diagnose(diagnose::Args) => diagnose::run,
    /// Apply a saved model to a fresh log of the same unit.
    Check(check::Args) => check::run,
    /// Drive your own simulator with the pistons of a log, and state how far it is from the log.
    Compare(compare::Args) => compare::run,
    /// Write what a calibration file can hold of a saved model.
    Apply(apply::Args) => apply::run,
    /// Design a schedule that separates effects.
    Excite(excite::Args) => excite::run,
    /// Test the diagnosis on logs of the built-in plant with hidden labels.
    Exam(exam::Args) => exam::run,
}
