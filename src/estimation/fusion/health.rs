//! Sensor health: decides which parts of a reading the estimator may use.
//!
//! [`SensorMonitor::assess`] takes one reading (a sample, a failed transfer, or nothing), finds every
//! [`HealthCause`] in it and returns a [`HealthVerdict`]: which of the three sensors may be used, and whether the
//! pistons must be held. A cause stays *in force* until [`HealthConfig::recover_samples`] good readings in a row
//! have cleared it. Good samples are used during the recovery, so that the filter has converged when the hold ends.
//!
//! ```text
//!            fault                      fault
//!   clear ───────────► in force ◄──────────────┐
//!     ▲                    │ good reading      │
//!     └────────────── recovering (1 … n) ──────┘
//!        n-th good one: recovered
//! ```
//!
//! The limits are physical. Between two samples dt apart the rate changes by at most α_max·dt (largest angular
//! acceleration). A still accelerometer measures |a| = g. The field during alignment gives the strength and the dip
//! δ, sin δ = −m·u / (|m| |u|), of every later sample (u: up, propagated by the gyroscope).

mod cause;
mod checks;
mod config;
mod monitor;
mod reading;
mod repetition;
#[cfg(test)]
mod tests;

pub use cause::{CauseSet, HealthCause};
pub use checks::KnownErrors;
pub use config::{HealthConfig, Policies, Policy};
pub use monitor::{HealthAction, HealthVerdict, SensorMonitor};
pub use reading::FieldShape;
