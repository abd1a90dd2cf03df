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
