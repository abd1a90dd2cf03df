//! Learning the transmission: gains in a batch (Algorithm 1) and online (k_ε), and the dynamics.

pub mod batch;
pub mod dynamics;
pub mod online;
pub mod sides;
pub mod static_error;
