//! Learning the transmission in a batch (Algorithm 1).

pub mod batch;
pub mod sides;
