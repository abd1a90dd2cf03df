//! The paper's experiment (§V): 120 held states in open and closed loop, and the identification of the gains.

pub mod arm;
pub mod evaluation;
pub mod identify;
pub mod pose;
pub mod rig;
pub mod schedule;
