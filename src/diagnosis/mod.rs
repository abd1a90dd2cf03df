//! Diagnosis of the sim-to-real gap: where it lies, which effect causes it, and how much of it the effect closes.
//!
//! A log is a [`problem`]: effects that may act in it, and how well each set of them explains parts of it that its fit has not seen.
//! [`search`] fits the sets ([`candidates`]), [`verdict`] gives every statement about the log a probability and takes the most probable,
//! and [`diagnose()`] is the whole way to the document. A log of a bending [`tip`] is one such problem, a log of any other [`rig`] with
//! one output another. [`plausibility`] refuses a log whose units or wiring cannot be right. [`fleet`] compares many units, and
//! [`excite`] designs schedules.

pub mod candidates;
pub mod diagnose;
pub mod excite;
pub mod fleet;
pub mod judgement;
pub mod plausibility;
pub mod problem;
pub mod rig;
pub mod tip;
pub mod verdict;

pub use candidates::{Candidates, Scored};
pub use diagnose::{Diagnosed, diagnose, search, statements};
pub use judgement::{Checked, Judgement};
pub use problem::{Documented, Judged, Problem};
