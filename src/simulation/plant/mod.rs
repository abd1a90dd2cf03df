//! The built-in plant: a simulated machine with laws of its own.
//!
//! One step is [`Plant::step`]: microstep counts pass through drive, line, bellows and shape to the true
//! orientation of the tip, which the IMU then measures. Each effect beyond the nominal model is one file of
//! [`effects`], with its parameters, its random draws, its law and its test. The laws deliberately differ in form
//! from those that the diagnosis fits, so that an effect has to be found by its signature.
//!
//! The plant has its own seeded random numbers and its own time; equal configuration, seed and counts give
//! equal output to the last bit. A step allocates nothing.

mod bellows;
mod chain;
pub mod config;
mod drive;
pub mod effects;
mod fault;
pub mod imu;
mod law;
mod line;
mod memory;
mod parameters;
mod prelude;
mod rng;
mod shape;
mod stand;
mod unit;

pub use chain::{Output, Plant, Truth};
pub use config::PlantConfig;
pub use effects::{EffectName, effect_names};
pub use fault::{BURST_PER_S, Faults, ImuFaults};
pub use parameters::PlantError;
