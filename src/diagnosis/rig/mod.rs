//! Diagnosis of other rigs with one output: nominal model, effects, verdict.
//!
//! The nominal model is identified on the log, every operator is fitted jointly with it, and sets of them are searched and judged as those
//! of a tip are: by a posterior, whose weights are fitted to random rigs.

pub mod document;
pub mod file;
pub mod model;
pub mod operators;
pub mod poses;
pub mod problem;
pub mod regress;
pub mod search;
pub mod table;
