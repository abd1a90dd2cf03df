//! The built-in plant: general properties, signatures of the effects, sensors, faults, and the paper twin.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    dead_code,
    clippy::needless_borrows_for_generic_args,
    clippy::unnecessary_operation
)]

#[path = "plant/faults.rs"]
mod faults;
#[path = "plant/laws.rs"]
mod laws;
#[path = "plant/open_loop.rs"]
mod open_loop;
#[path = "plant/rig.rs"]
mod rig;
#[path = "plant/sensors.rs"]
mod sensors;
#[path = "plant/signatures.rs"]
mod signatures;
#[path = "plant/twin.rs"]
mod twin;
