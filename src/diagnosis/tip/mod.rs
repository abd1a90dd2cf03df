//! Diagnosis of a bending tip.
//!
//! [`observed`] turns a log into weighted bins. [`model`] runs the controller's own model forward from the pistons to the readings, with any
//! set of catalogue effects in it. [`fit`] estimates nominal gains and effect parameters jointly and scores a fit on parts of the log it has
//! not seen. [`TipProblem`] is the whole as a [`crate::diagnosis::Problem`], and [`document`] what is written of it.

pub mod check;
pub mod confusion;
pub mod document;
pub mod fit;
pub mod location;
pub mod model;
pub mod observed;
pub mod problem;
pub mod remedy;
pub mod rig;
pub mod saved;

pub use check::check;
pub use confusion::{alike, confused_with, separable, separated_by};
pub use document::{
    Diagnosed, Diagnosis, EffectEntry, Gap, LogEntry, ParamValue, UnknownEntry, goes_with,
};
pub use location::{
    Location, QuantityShare, Region, StageShare, When, bend_without, commanded_bend, polar_deg,
};
pub use problem::{TipProblem, recalibrated};
pub use remedy::Remedy;
pub use rig::Rig;
pub use saved::{SavedGains, SavedModel};
