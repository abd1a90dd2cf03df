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

use crate::frames::{Base, Rotation, Tip};
use crate::fuse::health::Outcome;
use crate::sample::ImuSample;
use crate::units::{Seconds, Steps};
use crate::world::{Nature, World, WorldError};

/// What came from the machine in one turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensed {
    /// Time of the turn on the loop's clock, as handed in.
    pub t: Seconds,
    /// The tip's IMU: the newest sample not handed over yet, a failed transfer, or nothing.
    pub imu: Outcome,
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

/// Input lines, polarity already taken care of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Inputs {
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// Home switches of channels 1 to 3 are closed.
    pub home: [bool; 3],
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
    Starved,
    /// What it was handed jumps, mm.
    Torn {
        /// The jump, mm.
        gap_mm: f64,
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
            Self::Starved => f.write_str("the step thread ran out of motion and braked"),
            Self::Torn { gap_mm } => write!(f, "the motion handed to the step thread jumps by {gap_mm:.3} mm"),
            Self::Pins => f.write_str("the pins cannot be written or read"),
            Self::Dead => f.write_str("the step thread is gone"),
        }
    }
}

/// Something that bends a tip and feels it.
pub trait Machine: Send {
    /// What it is.
    fn nature(&self) -> &Nature;

    /// One turn of the loop at `now` (strictly later than the last): takes the counts that are wanted by
    /// the end of the coming period and hands over what has come since the last turn. Never blocks.
    ///
    /// # Errors
    /// [`WorldError`] when the other side is gone for good.
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, WorldError>;

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
    fn nature(&self) -> &Nature {
        (**self).nature()
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, WorldError> {
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

/// Turns of a world that one turn of a late loop may catch up on at most.
const CATCH_UP_MAX: u32 = 2000;

/// Any [`World`] as a machine: with drivers off it stands, and a late loop finds that the world went on
/// without it, on the counts it had.
#[derive(Debug, Clone)]
pub struct Lockstep<W> {
    /// The world.
    pub world: W,
    /// Time the world has reached.
    reached_s: f64,
    /// Counts that the world was told last; it counts from its own zero.
    held: Steps,
    /// World counts that the loop calls zero.
    zero: Steps,
    energised: bool,
}

impl<W: World> Lockstep<W> {
    /// A world at rest with its drivers off.
    pub fn new(world: W) -> Self {
        Self { world, reached_s: 0.0, held: Steps::default(), zero: Steps::default(), energised: false }
    }
}

impl<W: World + Send> Machine for Lockstep<W> {
    fn nature(&self) -> &Nature {
        self.world.nature()
    }

    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, WorldError> {
        let period_s = self.world.nature().period_s;
        let mut said = Sensed {
            t: now,
            imu: Outcome::Nothing,
            base_imu: None,
            counted: Steps::default(),
            energised: self.energised,
            inputs: Inputs::default(),
            alarm: None,
            truth: None,
        };
        let periods = (((now.0 - self.reached_s) / period_s).round().max(0.0) as u32).min(CATCH_UP_MAX);
        for k in 0..periods {
            // what is wanted now is only there in the last of several periods
            if k + 1 == periods && self.energised {
                self.held = Steps([0, 1, 2].map(|i| wanted.0[i].wrapping_add(self.zero.0[i])));
            }
            let reply = self.world.step(&self.held)?;
            if let Some(sample) = reply.imu {
                said.imu = Outcome::from_world(Some(sample));
            }
            said.truth = reply.truth;
        }
        self.reached_s += f64::from(periods) * period_s;
        said.counted = Steps([0, 1, 2].map(|i| self.held.0[i].wrapping_sub(self.zero.0[i])));
        Ok(said)
    }

    fn energise(&mut self, on: bool) {
        self.energised = on;
    }

    fn recount(&mut self, counted: &Steps) {
        self.zero = Steps([0, 1, 2].map(|i| self.held.0[i].wrapping_sub(counted.0[i])));
    }

    fn clear(&mut self) {}

    fn is_simulated(&self) -> bool {
        true
    }

    fn remarks(&self) -> Vec<String> {
        vec![format!("plant {}", self.world.nature().name)]
    }
}
