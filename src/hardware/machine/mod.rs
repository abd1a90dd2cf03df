//! The machine made of hardware: step thread, IMU threads and input lines behind
//! [`crate::supervisor::machine::Machine`].
//!
//! ```text
//!  loop ──turn(now, wanted)──▶ Drive ─ Motion ─ ring ─▶ step thread ──▶ pins      position counted
//!       ◀──────Sensed───────── Sensor ◀─ ring ── IMU thread ◀── I²C               = what was pulsed
//! ```
//!
//! Samples are handed over as the chip gives them, turned by the mount; the loop corrects them.
//!
//! No thread waits for another. A bus that hangs keeps only its own thread; the loop then sees no
//! reading, and its judge of health does the rest.

mod drive;
mod error;
mod hardware;
mod sensor;

pub use drive::{Drive, DriveState};
pub use error::HardwareError;
pub use hardware::Hardware;
pub use sensor::{Sensor, SensorConfig};

use crate::hardware::pins::PinsConfig;
use crate::motion::{MotionConfig, StepperConfig};

/// Everything that hardware is made from.
#[derive(Debug, Clone)]
pub struct MachineConfig {
    /// Name, for reports.
    pub name: String,
    /// Time of one turn of the loop, s.
    pub period_s: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Microsteps per full step.
    pub microsteps: u32,
    /// The wiring.
    pub pins: PinsConfig,
    /// Pulses and their thread.
    pub stepper: StepperConfig,
    /// Limits of motion.
    pub motion: MotionConfig,
    /// The tip's IMU.
    pub imu: Option<SensorConfig>,
    /// The base's IMU.
    pub base_imu: Option<SensorConfig>,
}
