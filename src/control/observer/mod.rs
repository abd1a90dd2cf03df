//! The observer: one belief about the tip, from which everything else in the loop follows.

pub mod bank;
mod config;
mod filter;
mod knowledge;
pub mod laws;
mod measure;
pub mod periodic;

/// Interval at which the observer and the bank take a measurement, s.
const PERIOD_S: f64 = 0.01;

pub use config::ObserverConfig;
pub use filter::Observer;
pub use knowledge::Knowledge;
pub use measure::Measured;
pub use periodic::{Periodic, PeriodicConfig};
