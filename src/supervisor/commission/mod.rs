//! Bringing a machine up: slow guarded moves, homing, and the proof that it is wired as the board says.
//!
//! | room | what |
//! |---|---|
//! | [`manual_motion`] | moves any [`crate::supervisor::machine::Machine`] slowly and watches it |
//! | [`homing`] | zero by home switches: approach, back off, repeat |
//! | [`turned`] | rotation of the tip since a moment, by the gyroscope |
//! | [`wiring`] | from three answers to what is connected to what |
//! | [`trial`] | the whole procedure, leak test included |
//!
//! Nothing here knows whether the machine is hardware or a simulation; time comes from the caller's clock.

pub mod homing;
pub mod manual_motion;
pub mod trial;
pub mod turned;
pub mod wiring;
