//! The observer: one belief about the tip, from which everything else in the loop follows.

pub mod bank;
mod filter;
pub mod laws;
pub mod periodic;

pub use filter::{Knowledge, Observer, ObserverConfig};
pub use periodic::{Periodic, PeriodicConfig};
