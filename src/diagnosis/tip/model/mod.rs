//! The model of a tip: from the pistons to the motion, and from the motion to the readings.

pub mod chain;
pub mod sense;
