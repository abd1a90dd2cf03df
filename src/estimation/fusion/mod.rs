//! Orientation of the tip from its IMU: generic filters, the bend-constrained filter, alignment and sensor health.
//!
//! | module | contents |
//! |---|---|
//! | [`filter`] | the interface of the orientation filters and of the tip estimators |
//! | [`madgwick`], [`vqf`], [`mekf`] | generic orientation filters; [`registry`] lists them by name |
//! | [`bend`] | the filter that is constrained to the motion of the bellows |
//! | [`estimator`] | the estimator that the loop has selected; [`second`] compares it with an independent one |
//! | [`align`], [`base`], [`base_watch`], [`sway`] | the still stretch at the start, and motion of the base after it |
//! | [`health`] | whether a reading may be used |
//! | [`tip`] | the whole chain, from a reading to the tip's bend |
//!
//! All filters are causal, take time as an argument and allocate nothing in `update`. A value that is missing,
//! not finite or outside the range of any sensor is left out ([`intake::usable`]).

pub mod align;
pub mod base;
pub mod base_watch;
pub mod bend;
pub mod correction_smoother;
pub mod estimator;
pub mod field_gate;
pub mod filter;
pub mod generic;
pub mod health;
pub mod intake;
pub mod madgwick;
pub mod mekf;
pub mod registry;
pub mod second;
pub mod standstill;
pub mod sway;
pub mod tip;
pub mod twist_law;
pub mod vqf;

pub use filter::{FilterStatus, OrientationFilter, Periods, TipEstimator, TipSample};
pub use registry::{Filter, FilterName};
