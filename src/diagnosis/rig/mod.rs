//! Diagnosis of other rigs with one output: nominal model, effects, verdict.

pub mod diagnose;
pub mod document;
pub mod features;
pub mod file;
pub mod model;
pub mod operators;
pub mod regress;
pub mod search;
pub mod table;
