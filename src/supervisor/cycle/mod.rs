//! The supervisor: one cycle of the supervised loop on any machine.
//!
//! ```text
//!  Sensed ─▶ tick ─▶ requested counts ─▶ gate ─▶ counts to send
//!             │  ╲                         │ trip
//!   order ────┘   residual monitor         └──────▶ mode
//! ```
//!
//! The service, the drills and the soak test run the same cycle; only the machine and the source of the orders differ.
//! A cycle neither allocates nor locks, and takes the time as an argument.

mod obey;
pub mod order;
mod reference;
pub mod restart_check;
pub mod runner;
mod sensor_watch;
mod source;
mod state;
mod turn;
mod types;

pub use source::Source;
pub use state::Supervisor;
pub use types::{CycleOutput, SupervisorConfig};
