//! The paper's experiment (§V): 120 held states in open and closed loop, and the identification of the gains; over
//! conditions, with one mechanism off at a time, and along paths.

pub mod ablation;
pub mod arm;
pub mod compare;
pub mod diagnosed;
pub mod error;
pub mod evaluation;
pub mod identify;
pub mod path;
pub mod rig;
pub mod schedule;
pub mod sweep;
pub mod track;
