//! A machine as the service sees it: a world with drivers, input lines and alarms of its own.
//!
//! ```text
//!  loop: wait until k·period ─▶ Machine::turn(now, wanted) ─▶ Sensed ─▶ tick, gate ─▶ wanted ─┐
//!         ▲                                                                                   │
//!         └───────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! The loop owns the clock and hands the time in; a machine never sleeps, locks, allocates or waits for
//! a device in [`Machine::turn`]: hardware reads its IMU and moves its pins in threads of its own and
//! exchanges with them through wait-free rings. What goes wrong outside is a value in [`Sensed`]; an
//! error is only what leaves nothing to talk to.
//!
//! [`Lockstep`] makes a machine of any [`World`], so the built-in plant, a foreign plant and the
//! hardware are interchangeable.

use crate::estimation::fusion::health::ImuReading;
use crate::motion::lines::Inputs;
use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Seconds, Steps};
use thiserror::Error;

/// What came from the machine in one turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensed {
    /// Time of the turn on the loop's clock, as handed in.
    pub t: Seconds,
    /// The tip's IMU: the newest sample not handed over yet, a failed transfer, or nothing.
    pub imu: ImuReading,
    /// The base's IMU, where there is one.
    pub base_imu: Option<ImuSample>,
    /// Microsteps truly pulsed by now, signed, since zero.
    pub counted: Steps,
    /// The drivers are energised.
    pub energised: bool,
    /// The input lines.
    pub inputs: Inputs,
    /// What the step generator complains of, until [`Machine::clear`].
    pub alarm: Option<Alarm>,
    /// True tip orientation, where the world knows it: for judges, never for the loop.
    pub truth: Option<Rotation<Base, Tip>>,
}

/// What a step generator complains of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Alarm {
    /// A step was this much later than it may be, s.
    Late {
        /// How late, s.
        late_s: f64,
    },
    /// It ran out of motion while moving and braked.
    Underrun,
    /// What it was handed jumps, mm.
    Discontinuity {
        /// The jump, mm.
        jump_mm: f64,
    },
    /// Its pins cannot be written or read.
    Pins,
    /// Its thread is gone.
    Dead,
}

impl std::fmt::Display for Alarm {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Late { late_s } => write!(f, "a step came {:.1} ms late", late_s * 1e3),
            Self::Underrun => f.write_str("the step thread ran out of motion and braked"),
            Self::Discontinuity { jump_mm } => write!(f, "the motion handed to the step thread jumps by {jump_mm:.3} mm"),
            Self::Pins => f.write_str("the pins cannot be written or read"),
            Self::Dead => f.write_str("the step thread is gone"),
        }
    }
}

/// What a world says of itself before time starts.
#[derive(Debug, Clone, PartialEq)]
pub struct MachineInfo {
    /// Name, for reports.
    pub name: String,
    /// Length of one step of its time, s.
    pub period_s: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
}

/// Why a world ended.
#[derive(Debug, Error)]
pub enum MachineError {
    /// The built-in plant cannot run with its parameters.
    #[error("{0}")]
    Plant(String),
    /// The program could not be started.
    #[error("plant `{program}` cannot be started: {source}; give --plant 'exec:PROGRAM ARG…' with a program on this machine")]
    Start {
        /// What was to be run.
        program: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A line that is not what the protocol says.
    #[error("plant said `{line}`: {problem}")]
    Malformed {
        /// The line, cut to a readable length.
        line: String,
        /// What is wrong with it and what was expected.
        problem: String,
    },
    /// End of file before its time.
    #[error("plant ended after `{last}`{status}; its own error output is above")]
    Died {
        /// The last good line.
        last: String,
        /// Exit status, if known.
        status: String,
    },
    /// Nothing came for too long.
    #[error("plant was silent for {seconds} s after `{last}`; it must answer every line of steps with one line")]
    Silent {
        /// How long was waited, s.
        seconds: f64,
        /// The last good line.
        last: String,
    },
}

/// Something that bends a tip and feels it.
pub trait Machine: Send {
    /// What it is.
    fn info(&self) -> &MachineInfo;

    /// One turn of the loop at `now` (strictly later than the last): takes the counts that are wanted by
    /// the end of the coming period and hands over what has come since the last turn. Never blocks.
    ///
    /// # Errors
    /// [`MachineError`] when the other side is gone for good.
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError>;

    /// Switches the drivers; off, the air may push the pistons back. Acts within some turns, which
    /// [`Sensed::energised`] tells.
    fn energise(&mut self, on: bool);

    /// At rest: the pistons stand at these counts, as remembered or as found at the home switches.
    fn recount(&mut self, counted: &Steps);

    /// Takes back a latched [`Alarm`], as far as its cause is gone.
    fn clear(&mut self);

    /// True where time is the loop's own and nothing needs to be waited for: a simulation may run as
    /// fast as both sides can.
    fn is_simulated(&self) -> bool;

    /// What a person should know of it, one line each: real-time grants, devices. For the status.
    fn remarks(&self) -> Vec<String>;
}

impl<M: Machine + ?Sized> Machine for Box<M> {
    fn info(&self) -> &MachineInfo {
        (**self).info()
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        (**self).turn(now, wanted)
    }
    fn energise(&mut self, on: bool) {
        (**self).energise(on);
    }
    fn recount(&mut self, counted: &Steps) {
        (**self).recount(counted);
    }
    fn clear(&mut self) {
        (**self).clear();
    }
    fn is_simulated(&self) -> bool {
        (**self).is_simulated()
    }
    fn remarks(&self) -> Vec<String> {
        (**self).remarks()
    }
}
