//! Supervision of the control loop: modes, safety gate, orders, residual monitor and commissioning.
//!
//! * [`mode`]: the modes and one table of all transitions.
//! * [`gate`]: the last check between controller and step generator; it relies on neither.
//! * [`residual_monitor`]: attributes the difference between predicted and estimated bend to a cause, a [`suspicion`].
//! * [`machine`]: the trait that hardware and simulations implement.
//! * [`cycle`]: one cycle of the supervised loop, the same on every machine.
//! * [`commission`]: guarded manual moves, homing, and the wiring and leak tests.
//!
//! The room is pure: time is an argument, and a cycle does not allocate.

pub mod commission;
pub mod cycle;
pub mod gate;
pub mod machine;
pub mod mode;
pub mod residual_monitor;
pub mod suspicion;
