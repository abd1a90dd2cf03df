//! Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks.
//!
//! `observe` turns a log into bins with weights; `chain` runs the controller's own model forward from
//! the pistons with any set of catalogue effects in it; `fit` estimates nominal gains and effect
//! parameters jointly; `search` finds the smallest set that explains the log on parts that no fit has
//! seen; `diagnose` puts the answers together.

pub mod begin;
pub mod chain;
pub mod credit;
pub mod decide;
pub mod diagnose;
pub mod exam;
pub mod excite;
pub mod fit;
pub mod holdout;
pub mod interval;
pub mod map;
pub mod observe;
pub mod saved;
pub mod search;
pub mod sense;
pub mod slope;
pub mod structure;
