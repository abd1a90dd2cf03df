//! Fault injection: every fault that the project claims to survive, injected during a move.
//!
//! A fault in flight is injected into the simulated plant, which runs under the same supervisor, gate and memory as the
//! service. A row reports the time to the first detection, the microsteps that followed, the final state and the message.
//! Then the cause is repaired, the operator's recovery procedure is followed, and the error of the next pose is measured
//! against the plant's true orientation. Faults of the process are injected into real child processes.
//!
//! * [`mod@bench`]: supervisor and faulty machine; [`spec`] and [`list`]: the faults; [`run`]: one flight.
//! * [`process`]: kills, stops, disks, clients; [`soak`]: hours of random commands and faults.

pub mod bench;
pub mod list;
pub mod process;
pub mod row;
pub mod run;
pub mod soak;
pub mod spec;
