//! The paper's experiment (§V): 120 held states, open loop and closed, and the identification.

pub mod arm;
pub mod evaluation;
pub mod identify;
pub mod pose;
pub mod rig;
pub mod schedule;
