//! The words the step thread and the loop speak: faults, modes, orders, inputs, reports.

use crate::motion::histogram::Histogram;
use crate::motion::lines::Inputs;
use crate::primitives::units::Steps;

/// Why the core does not move any more.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum StepperFault {
    /// A step could not be made in time.
    #[error("a step of channel {} was {:.3} ms late: the step thread was kept from running (see `retroflex bench rt`)", .channel + 1, *.late_ns as f64 * 1e-6)]
    Late {
        /// Channel, from 0.
        channel: usize,
        /// How late, ns.
        late_ns: u64,
    },
    /// A segment does not start where the last one ended, is faster than the limits or no number.
    #[error("the motion handed to channel {} jumps by {jump_mm} mm", .channel + 1)]
    Discontinuity {
        /// Channel, from 0.
        channel: usize,
        /// The jump, mm.
        jump_mm: f64,
    },
    /// The pins refused a write or a read.
    #[error("the pins refused to be written or read")]
    Pins,
    /// The emergency stop was pressed.
    #[error("the emergency stop was pressed")]
    EmergencyStop,
}

/// What the core is at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StepperMode {
    /// At rest, waiting for segments.
    Resting,
    /// Working off segments.
    Following,
    /// Braking within the limits.
    Stopping,
    /// Stopped for good, until cleared.
    Faulted(StepperFault),
}

/// What the loop can order past the queue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StepperOrder {
    /// Brake within the limits; drop what is queued.
    Stop,
    /// Energise the drivers.
    Energise,
    /// Release the drivers, once at rest.
    Release,
    /// Leave a fault. Ignored while the emergency stop is pressed.
    Clear,
    /// At rest: these are the piston positions now, mm.
    Rebase([f64; 3]),
    /// Brake, release the drivers, be done.
    Finish,
}

/// Everything the core tells the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepperReport {
    /// When, ns of the monotonic clock.
    pub t_ns: u64,
    /// What it is at.
    pub mode: StepperMode,
    /// Segments of this epoch are taken.
    pub epoch: u32,
    /// Steps really pulsed, signed, since zero.
    pub counted: Steps,
    /// Where the pistons rest, mm; meaningful in [`StepperMode::Resting`] and [`StepperMode::Faulted`].
    pub rest_mm: [f64; 3],
    /// The drivers are energised.
    pub energised: bool,
    /// Input lines.
    pub inputs: Inputs,
    /// How often the queue ran dry in motion.
    pub dry: u32,
    /// Segments refused: of an old epoch, or too late to be begun.
    pub refused: u32,
    /// From the instant a step was due to the end of the write that made it.
    pub lateness: Histogram,
}
