//! Supervision of the control loop: modes, safety gate, orders, residual monitor and commissioning.
//!
//! * [`mode`]: one table of transitions; nothing else changes the mode.
//! * [`gate`]: stands between the controller and the step generator and trusts neither.
//! * [`residual_monitor`]: turns the difference between what the pistons did and what the IMU measured into a cause.
//! * [`machine`]: the trait that hardware and simulations implement.
//! * [`cycle`]: one cycle of the supervised loop, the same on every machine.
//!
//! Everything here is pure: time is passed in, nothing allocates.

pub mod commission;
pub mod cycle;
pub mod gate;
pub mod machine;
pub mod mode;
pub mod residual_monitor;
