//! Learning the transmission: in a batch (Algorithm 1), online (k_ε), and its dynamics.

pub mod batch;
pub mod dynamics;
pub mod online;
