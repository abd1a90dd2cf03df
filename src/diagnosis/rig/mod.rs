//! Diagnosis of other rigs with one output: nominal model, effects, verdict.
//!
//! The nominal model is identified on the log, every operator is fitted jointly with it, and sets of them are searched and judged as those
//! of a tip are: by a posterior, whose weights are fitted to random rigs.

pub mod check;
pub mod document;
pub mod file;
pub mod model;
pub mod operators;
pub mod poses;
pub mod problem;
mod refine;
pub mod regress;
pub mod saved;
pub mod table;
#[cfg(test)]
mod tests;

pub use check::check;
pub use document::{Document, Entry};
pub use file::{MapFile, Nominal};
pub use model::{MapBase, Member, Scale};
pub use operators::{
    DRIVEN, Drive, Operator, RESONANT, catalogue, oscillator, oscillator_step, play,
};
pub use poses::{notes, poor};
pub use problem::{RigProblem, Set};
pub use regress::{Regressed, Task, closed_ci95, variance};
pub use saved::SavedRig;
pub use table::Signals;
