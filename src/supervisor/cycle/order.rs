//! Orders to the supervisor, and the reasons for refusing them.

use crate::model::{Line, Shape};
use crate::supervisor::Mode;

/// Largest bend that may be ordered, rad (135°).
pub const BEND_MAX_RAD: f64 = std::f64::consts::PI * 0.75;

/// An order, small enough for a wait-free ring.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Order {
    /// Energises the drivers and holds the present pose.
    Arm,
    /// Accepts no more motion; the drivers are released if the pistons are at zero.
    Disarm,
    /// Bends to a target, optionally at a given speed in rad/s.
    Bend(Shape, Option<f64>),
    /// Like [`Order::Bend`] as part of a stream: the tip stops when the stream falls silent.
    Stream(Shape),
    /// Comes to rest smoothly at the set-point and holds.
    Hold,
    /// Brakes at once and holds; until the next [`Order::Arm`] nothing starts a motion.
    Stop,
    /// Returns to rest slowly, then releases the drivers.
    Relax,
    /// Defines the present pose as rest, if the remembered attitude confirms that the tip is straight.
    Zero,
    /// Defines the present pose as rest on the operator's word that the tip is straight.
    AssertStraight,
    /// Clears the latched fault.
    Reset,
    /// Begins (true) or ends (false) an open-loop calibration.
    Calibrate(bool),
    /// Replaces the transmission gains.
    Lines([Line; 3]),
    /// Like [`Order::Stream`], for a time in s on the clock of the stream: the tip follows a smooth curve through the set-points.
    Timed(Shape, f64),
    /// Follows the path that was loaded.
    Play,
    /// Keeps the orientation in the world that this bend has now, optionally at a given speed in rad/s.
    World(Shape, Option<f64>),
}

impl Order {
    /// True for an order that can start a motion. A latched stop refuses it, and so does a stop that overtook it.
    pub fn starts_motion(&self) -> bool {
        self.leads_setpoint() || matches!(self, Self::Arm | Self::Relax | Self::Calibrate(true))
    }

    /// True for an order that takes part in a calibration: while one is running, nobody else may give it.
    pub fn calibrates(&self) -> bool {
        self.leads_setpoint() || matches!(self, Self::Lines(_) | Self::Calibrate(_))
    }

    /// True for an order that gives the set-point a target or another lead.
    pub fn leads_setpoint(&self) -> bool {
        matches!(
            self,
            Self::Bend(..) | Self::Stream(_) | Self::Timed(..) | Self::Play | Self::World(..)
        )
    }
}

/// Why an order was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The mode does not allow the order.
    #[error("not while {0}: {hint}", hint = hint(*.0))]
    Mode(Mode),
    /// A stop is latched.
    #[error("stopped: `retroflex arm` first")]
    Stopped,
    /// The tip is not straight, in tenths of a degree from the remembered attitude.
    #[error(
        "the tip hangs {}.{}° away from the remembered straight attitude: straighten it, or state that it is straight with `retroflex zero --straight`",
        .0 / 10, .0 % 10
    )]
    NotStraight(u16),
    /// No attitude is remembered.
    #[error(
        "no straight attitude is remembered, so nothing measures how straight the tip is: relax it by hand, then state that it is straight with `retroflex zero --straight`"
    )]
    Unmeasured,
    /// A fault is latched.
    #[error(
        "a fault is latched; see `retroflex status`, remove the cause, then `retroflex reset-fault`"
    )]
    Latched,
    /// The cause of the fault persists.
    #[error(
        "the cause of the fault persists: release the emergency stop, or remove the cause that `retroflex status` names"
    )]
    StillThere,
    /// A value is NaN or infinite.
    #[error("bend, direction, length and speed must be finite numbers")]
    NotANumber,
    /// The bend is too large.
    #[error("the bend must lie within ±135°")]
    TooFar,
    /// The tip cannot bend so far in this direction; the largest bend there, in tenths of a degree.
    #[error("the tip bends by at most {}.{}° in this direction, by the range of its bellows and pistons ([geometry] and [limits] of the board file)", .0 / 10, .0 % 10)]
    Unreachable(u16),
    /// The length is outside the range of the bellows.
    #[error("the length must lie within the range of the bellows ([geometry] of the board file)")]
    Length,
    /// The speed is out of range.
    #[error("the speed must lie between 0.1 and 720 °/s")]
    Speed,
    /// The pistons are not at zero.
    #[error(
        "the pistons are not at zero: run `retroflex relax` first, so that the tip is really at rest"
    )]
    NotAtRest,
    /// The gains are outside the physical range.
    #[error("gains must lie within 0 to 10 (k_ε) and 0 to 3 mm (k_λ)")]
    Gains,
    /// The order is too old.
    #[error("the loop did not respond in time, so nothing was done; try again")]
    Late,
    /// A motion has not ended, or the drivers are not energised yet.
    #[error("still braking or energising; try again in a moment")]
    Busy,
    /// No IMU on the base measures how it turns.
    #[error(
        "no healthy IMU on the base measures how it turns: bend without `--world`, or see `retroflex status`"
    )]
    NoBase,
    /// The time of a set-point is not later than that of the one before.
    #[error(
        "the times of a stream must increase from each set-point to the next until the stream ends"
    )]
    Backwards,
    /// A set-point comes too early.
    #[error("a set-point may come at most 1 s ahead of its time")]
    Ahead,
    /// No path was loaded.
    #[error("no path was given")]
    NoPath,
    /// The position is unknown, and no steps are remembered.
    #[error(
        "the position of the pistons is unknown, and no steps are remembered by which they could be driven back: relax the tip by hand, then run the `zero` that `retroflex status` names"
    )]
    NoSteps,
}

impl Refusal {
    /// True if the order itself is invalid, in whatever state.
    pub fn is_invalid_order(&self) -> bool {
        matches!(
            self,
            Self::NotANumber
                | Self::TooFar
                | Self::Unreachable(_)
                | Self::Length
                | Self::Speed
                | Self::Gains
                | Self::Backwards
                | Self::Ahead
        )
    }
}

/// What is to be done, or waited for, in a mode.
pub fn hint(mode: Mode) -> &'static str {
    match mode {
        Mode::Boot => "the devices are being opened",
        Mode::Aligning => "the tip must be still for 2 s first",
        Mode::Disarmed => "`retroflex arm` first",
        Mode::Holding => "`retroflex relax` first",
        Mode::Tracking => "`retroflex stop` first",
        Mode::Relaxing => "the tip is returning to rest",
        Mode::Calibrating => "a calibration is running; `retroflex stop` ends it",
        Mode::Faulted => {
            "remove the cause, then `retroflex reset-fault`; `retroflex relax` returns the tip to rest"
        }
        Mode::Lost => {
            "the position of the pistons is unknown; `retroflex status` says what ends that"
        }
    }
}
