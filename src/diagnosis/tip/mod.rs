//! Diagnosis of a bending tip.

pub mod check;
pub mod confusion;
pub mod credit;
pub mod diagnose;
pub mod document;
pub mod features;
pub mod fit;
pub mod location;
pub mod model;
pub mod observed;
pub mod remedy;
pub mod rig;
pub mod saved;
pub mod search;
