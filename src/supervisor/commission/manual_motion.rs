//! A slow hand on a machine: one target after another, every turn watched.
//!
//! The hand asks for positions along a ramp of constant speed; limits of acceleration and travel are the
//! machine's own. Whatever goes wrong ends the move, and the pistons stand where they are.

use crate::primitives::units::{Seconds, Steps};
use crate::supervisor::machine::MachineError;
use crate::supervisor::machine::{Alarm, Machine, Sensed};

/// Longest that counts may lag behind at the end of a move, s.
const ARRIVE_MAX_S: f64 = 2.0;
/// Longest that drivers may take to switch, s.
const SWITCH_MAX_S: f64 = 1.0;

/// Why a move ended before its end.
#[derive(Debug, thiserror::Error)]
pub enum HandError {
    /// The machine is gone.
    #[error(transparent)]
    World(#[from] MachineError),
    /// The step generator complains.
    #[error("stopped: {alarm}{}", .words.as_ref().map_or(String::new(), |w| format!(" ({w})")))]
    Alarm {
        /// What it says.
        alarm: Alarm,
        /// Details, where the machine has any.
        words: Option<String>,
    },
    /// The red button.
    #[error("stopped: the emergency stop is pressed; release it and start again")]
    EmergencyStop,
    /// The caller wants no more.
    #[error("stopped as asked")]
    Cancelled,
    /// Counts did not follow.
    #[error("the pistons did not arrive within {0} s: {1} is where they stand in steps; see `retroflex bench rt`")]
    NotArrived(f64, String),
    /// Drivers did not switch.
    #[error("the drivers did not switch {0} within 1 s")]
    NotSwitched(&'static str),
}

/// Waits until a time of the loop's clock and says how late it is; `None` asks to stop.
pub type Wait<'a> = dyn FnMut(Seconds) -> Option<Seconds> + 'a;

/// A hand on a machine.
pub struct Hand<'a> {
    machine: &'a mut dyn Machine,
    wait: &'a mut Wait<'a>,
    now: Seconds,
    wanted_mm: [f64; 3],
    last: Option<Sensed>,
}

impl<'a> Hand<'a> {
    /// A hand on a machine that has not turned yet. For a simulation `wait` answers at once.
    pub fn new(machine: &'a mut dyn Machine, wait: &'a mut Wait<'a>) -> Self {
        // whatever a program before this one left energised: pistons are brought to rest by people here
        machine.energise(false);
        Self { machine, wait, now: Seconds(0.0), wanted_mm: [0.0; 3], last: None }
    }

    /// Piston travel per microstep, mm.
    #[must_use]
    pub fn step_mm(&self) -> f64 {
        self.machine.info().step_mm
    }

    /// Where the pistons are wanted, mm.
    #[must_use]
    pub fn wanted_mm(&self) -> [f64; 3] {
        self.wanted_mm
    }

    /// Where they stand by the count, mm.
    #[must_use]
    pub fn stands_mm(&self) -> [f64; 3] {
        let step_mm = self.step_mm();
        self.last.map_or([0.0; 3], |s| s.counted.0.map(|n| f64::from(n) * step_mm))
    }

    fn steps(&self) -> Steps {
        let step_mm = self.step_mm();
        Steps(self.wanted_mm.map(|p| (p / step_mm).round() as i32))
    }

    /// One turn of the machine, and everything that may speak against going on.
    ///
    /// # Errors
    /// [`HandError`].
    pub fn turn(&mut self) -> Result<Sensed, HandError> {
        let next = Seconds(self.now.0 + self.machine.info().period_s);
        self.now = (self.wait)(next).ok_or(HandError::Cancelled)?;
        let sensed = self.machine.turn(self.now, &self.steps())?;
        self.last = Some(sensed);
        if sensed.inputs.emergency_stop {
            return Err(HandError::EmergencyStop);
        }
        match sensed.alarm {
            // a hand that starves only stands still for a moment
            None | Some(Alarm::Underrun) => Ok(sensed),
            Some(alarm) => {
                let words = self.machine.remarks().into_iter().find_map(|r| r.strip_prefix("pins: ").map(str::to_owned));
                Err(HandError::Alarm { alarm, words })
            }
        }
    }

    /// Lets time pass; every turn is shown to `see`.
    ///
    /// # Errors
    /// [`HandError`].
    pub fn stand(&mut self, seconds: f64, see: &mut dyn FnMut(&Sensed)) -> Result<(), HandError> {
        let until_s = self.now.0 + seconds;
        while self.now.0 < until_s {
            see(&self.turn()?);
        }
        Ok(())
    }

    /// Switches the drivers and waits until they are.
    ///
    /// # Errors
    /// [`HandError`].
    pub fn energise(&mut self, on: bool) -> Result<(), HandError> {
        self.machine.energise(on);
        let until_s = self.now.0 + SWITCH_MAX_S;
        while self.now.0 < until_s {
            if self.turn()?.energised == on {
                return Ok(());
            }
        }
        Err(HandError::NotSwitched(if on { "on" } else { "off" }))
    }

    /// Moves to `target_mm` at `speed_mm_s` (of the channel that goes farthest) until it is there, or until
    /// `enough` says so; then the pistons stand where they came to. True if it was enough.
    ///
    /// # Errors
    /// [`HandError`].
    pub fn go(&mut self, target_mm: [f64; 3], speed_mm_s: f64, enough: &mut dyn FnMut(&Sensed) -> bool) -> Result<bool, HandError> {
        let from_mm = self.wanted_mm;
        let way_mm = (0..3).map(|i| (target_mm[i] - from_mm[i]).abs()).fold(0.0, f64::max);
        let began_s = self.now.0;
        loop {
            let share = if way_mm > 0.0 { ((self.now.0 - began_s) * speed_mm_s / way_mm).min(1.0) } else { 1.0 };
            self.wanted_mm = std::array::from_fn(|i| from_mm[i] + share * (target_mm[i] - from_mm[i]));
            let sensed = self.turn()?;
            if enough(&sensed) {
                self.wanted_mm = self.stands_mm();
                self.arrive(enough)?;
                return Ok(true);
            }
            if share >= 1.0 {
                return self.arrive(enough);
            }
        }
    }

    /// Waits until the counts are where they are wanted; true if it was enough meanwhile.
    fn arrive(&mut self, enough: &mut dyn FnMut(&Sensed) -> bool) -> Result<bool, HandError> {
        let until_s = self.now.0 + ARRIVE_MAX_S;
        let mut met = false;
        while self.now.0 < until_s {
            let sensed = self.turn()?;
            met |= enough(&sensed);
            if sensed.counted == self.steps() {
                return Ok(met);
            }
        }
        let stands = self.last.map_or(Steps::default(), |s| s.counted);
        Err(HandError::NotArrived(ARRIVE_MAX_S, format!("{:?}", stands.0)))
    }

    /// Calls the place where the pistons stand by other counts.
    ///
    /// # Errors
    /// [`HandError::NotArrived`] when the machine does not take it over.
    pub fn recount(&mut self, counted: Steps) -> Result<(), HandError> {
        let step_mm = self.step_mm();
        self.machine.recount(&counted);
        self.wanted_mm = counted.0.map(|n| f64::from(n) * step_mm);
        self.arrive(&mut |_| false).map(|_| ())
    }
}
