//! What the step thread and the loop exchange besides segments: modes, faults, orders and reports, and what the loop knows of it.

use crate::motion::{Histogram, Inputs};
use crate::primitives::Steps;

/// Why the step core has stopped.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StepperFault {
    /// A step could not be made in time.
    #[error("a step of channel {} was {:.3} ms late: the step thread did not run in time (see `retroflex bench rt`)", .channel + 1, *.late_ns as f64 * 1e-6)]
    Late {
        /// Channel, from 0.
        channel: usize,
        /// Lateness, ns.
        late_ns: u64,
    },
    /// A segment does not start where the previous one ended, exceeds the speed limit or is not finite.
    #[error("the motion of channel {} jumps by {jump_mm} mm", .channel + 1)]
    Discontinuity {
        /// Channel, from 0.
        channel: usize,
        /// The jump, mm.
        jump_mm: f64,
    },
    /// A write or a read of the pins failed.
    #[error("the pins cannot be written or read")]
    Pins,
    /// The emergency stop was pressed.
    #[error("the emergency stop was pressed")]
    EmergencyStop,
}

/// Mode of the step core.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum StepperMode {
    /// At rest, waiting for segments.
    #[default]
    Resting,
    /// Following segments.
    Following,
    /// Braking within the limits.
    Stopping,
    /// Stopped until [`StepperOrder::Clear`].
    Faulted(StepperFault),
}

/// State of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DriveState {
    /// The drivers are off or about to be; targets are ignored.
    Off,
    /// Targets are followed.
    Ready,
    /// Braking or waiting; the target is followed later without a further call.
    Busy,
    /// Faulted until [`Drive::clear`](crate::motion::Drive::clear).
    Faulted(StepperFault),
    /// The step generator has ended.
    Dead,
    /// The step generator does not report.
    Silent,
}

/// An order that bypasses the queue of segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StepperOrder {
    /// Brakes within the limits and drops the queue.
    Stop,
    /// Energises the drivers.
    Energise,
    /// Releases the drivers. Ignored in motion.
    Release,
    /// Leaves a fault. Ignored while the emergency stop is pressed.
    Clear,
    /// Declares the piston positions, mm. Ignored unless at rest.
    Rebase([f64; 3]),
    /// Brakes, releases the drivers and ends the thread.
    Finish,
}

/// State of the step core.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepperReport {
    /// Time of the report, ns of the monotonic clock.
    pub t_ns: u64,
    /// Mode.
    pub mode: StepperMode,
    /// Epoch whose segments are accepted.
    pub epoch: u32,
    /// Steps pulsed since zero, signed.
    pub counted: Steps,
    /// All steps that were due before this time are counted, ns. It is `t_ns` unless a step is late.
    pub complete_ns: u64,
    /// Rest positions of the pistons, mm; valid in [`StepperMode::Resting`] and [`StepperMode::Faulted`].
    pub rest_mm: [f64; 3],
    /// The drivers are energised.
    pub energised: bool,
    /// Input lines.
    pub inputs: Inputs,
    /// Number of underruns: the queue was empty while the pistons moved.
    pub underruns: u32,
    /// Number of refused segments: of an old epoch, or too late to begin.
    pub refused: u32,
    /// Time from the instant at which a step was due to the end of the write that made it.
    pub lateness: Histogram,
}

impl StepperReport {
    /// Whether mode, epoch, counts, current or inputs differ from those of an earlier report.
    pub fn differs_from(&self, earlier: &Self) -> bool {
        let key = |r: &Self| (r.mode, r.epoch, r.counted, r.energised, r.inputs);
        key(self) != key(earlier)
    }
}
