//! Diagnosis of a bending tip.

pub mod check;
pub mod confusion;
pub mod credit;
pub mod document;
pub mod fit;
pub mod location;
pub mod model;
pub mod observed;
pub mod problem;
pub mod remedy;
pub mod rig;
pub mod saved;
pub mod search;

pub use check::{Checked, Judgement, check};
pub use confusion::{alike, confused_with, separable};
pub use credit::{StageShare, credits, stages};
pub use document::{
    DependenceEntry, Diagnosed, Diagnosis, EffectEntry, Gap, Location, LogEntry, ParamValue,
    QuantityShare, Region, UnknownEntry, When, goes_with,
};
pub use location::{BeforeAfter, commanded_bend, polar_deg};
pub use remedy::Remedy;
pub use rig::Rig;
pub use saved::{SavedGains, SavedModel};
pub use search::{TipProblem, recalibrated};
