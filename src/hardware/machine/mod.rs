//! The machine made of hardware: step thread, IMU threads and input lines behind
//! [`crate::motion::machine::Machine`].
//!
//! ```text
//!  loop ──turn(now, wanted)──▶ Drive ─ Motion ─ ring ─▶ step thread ──▶ pins      position =
//!       ◀──────Sensed───────── Sensor ◀─ ring ── IMU thread ◀── I²C               steps pulsed
//! ```
//!
//! Sensors deliver uncorrected samples, rotated by the mount; the loop applies the calibration.
//!
//! No thread waits for another. A bus that hangs blocks only its own thread. The loop then receives no
//! reading, and the health monitor reacts.

mod error;
mod gauges;
mod hardware;
mod reading;
mod sensor;

pub use error::HardwareError;
pub use gauges::GaugeConfig;
pub use hardware::{Hardware, MachineConfig};
pub use sensor::{ImuSection, Sensor, slowness};
