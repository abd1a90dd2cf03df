//! Supervision of the control loop: modes, safety gate, orders, residual monitor and commissioning.
//!
//! * [`mode`]: the modes and one table of all transitions.
//! * [`gate`]: the last check between controller and step generator; it relies on neither.
//! * [`residual_monitor`]: attributes the difference between predicted and estimated bend to a cause, a [`suspicion`].
//! * [`cycle`]: one cycle of the supervised loop, the same on every machine.
//! * [`commission`]: guarded manual moves, homing, and the wiring and leak tests.
//!
//! The room is pure: time is an argument, and a cycle does not allocate.

pub mod commission;
pub mod cycle;
pub mod gate;
pub mod mode;
pub mod residual_monitor;
pub mod suspicion;

pub use crate::control::{CauseSet, HealthCause, Path, RestartState};
pub use crate::model::{Bend, Shape};
pub use crate::motion::{Alarm, Machine, MachineError, MachineInfo, Sensed};
pub use cycle::order::{BEND_MAX_RAD, Order, Refusal};
pub use cycle::runner::Runner;
pub use cycle::{CycleOutput, Source, Supervisor, SupervisorConfig};
pub use gate::{GateLimits, SafeState, SafeStates, TripCause};
pub use mode::Mode;
pub use residual_monitor::{ResidualConfig, SuspicionKind};
