//! Learning the transmission in a batch (Algorithm 1).

pub mod batch;
pub mod identify;
pub mod schedule;
pub mod sides;
