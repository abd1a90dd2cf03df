//! Diagnosis of the sim-to-real gap: where it lies, which effect causes it, and how much of it the effect closes.
//!
//! [`tip`] turns the log of a bending tip into weighted bins, runs the controller's own model through it with any set of catalogue
//! effects, and searches the sets; [`rig`] does the same for any other machine with one output. Both give [`candidates`], of which
//! [`verdict`] chooses one. [`fleet`] compares many units, [`excite`] designs schedules, and [`exam`] tests the diagnosis on the
//! built-in plant.

pub mod candidates;
pub mod exam;
pub mod excite;
pub mod fleet;
pub mod rig;
pub mod tip;
pub mod verdict;
