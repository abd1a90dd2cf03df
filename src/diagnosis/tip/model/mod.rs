//! The model of a tip: from the pistons to the motion, and from the motion to the readings.

pub mod chain;
pub mod sense;

pub use chain::{FIRST_STEP_S, LAG_MAX_S, Motion, parameters, run};
pub use sense::{Residuals, every_bin, residuals, sense};
