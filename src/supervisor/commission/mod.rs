//! Commissioning: slow guarded moves, homing, and a test of the wiring and the tightness of the lines.
//!
//! | module | contents |
//! |---|---|
//! | [`manual_motion`] | slow supervised moves of any [`crate::motion::machine::Machine`] |
//! | [`homing`] | zero by home switches |
//! | [`rotation`] | rotation of the tip from the gyroscope |
//! | [`wiring`] | wiring that explains the measured responses |
//! | [`trial`] | the whole procedure with the leak test |
//!
//! The procedures are the same for hardware and simulations; the caller provides the clock.

pub mod homing;
pub mod manual_motion;
pub mod rotation;
pub mod trial;
pub mod wiring;
