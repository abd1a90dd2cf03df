//! The observer: one belief about the tip, from which everything else in the loop follows.

pub mod bank;
mod config;
mod filter;
mod knowledge;
pub mod laws;
pub mod periodic;

pub use config::ObserverConfig;
pub use filter::{Measured, Observer};
pub use knowledge::Knowledge;
pub use periodic::{Periodic, PeriodicConfig};
