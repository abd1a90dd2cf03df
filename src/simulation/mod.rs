//! Simulated machines: the built-in plant, and plants of other programs over the plant link.

pub mod described;
pub mod link;
pub mod lockstep;
pub mod plant;
mod rate_check;
pub mod sim;
pub mod world;

pub use crate::motion::{Machine, MachineError, MachineInfo, Sensed};
