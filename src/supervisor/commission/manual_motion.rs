//! Slow supervised moves: one target after another, every cycle checked.
//!
//! A move requests positions along a ramp of constant speed; the machine itself limits acceleration and travel. Any
//! fault ends the move, and the pistons stay where they stopped.

use crate::model::Drive;
use crate::primitives::{Seconds, Steps};
use crate::supervisor::{Alarm, Machine, MachineError, Sensed};
use nalgebra::Vector3;

/// Longest time for the counts to reach the target at the end of a move, s.
const ARRIVE_MAX_S: f64 = 2.0;
/// Longest time for the drivers to switch, s.
const SWITCH_MAX_S: f64 = 1.0;

/// Why a move ended early.
#[derive(Debug, thiserror::Error)]
pub enum ManualMotionError {
    /// The machine cannot be used any more.
    #[error(transparent)]
    World(#[from] MachineError),
    /// The step generator reports an alarm.
    #[error("stopped: {alarm}{}", .details.as_ref().map_or(String::new(), |w| format!(" ({w})")))]
    Alarm {
        /// The alarm.
        alarm: Alarm,
        /// Details, if the machine has any.
        details: Option<String>,
    },
    /// The emergency stop is pressed.
    #[error("stopped: the emergency stop is pressed; release it and start again")]
    EmergencyStop,
    /// The caller cancelled the move.
    #[error("stopped on request")]
    Cancelled,
    /// The counts did not reach the target.
    #[error(
        "the pistons did not arrive within {0} s; they stand at {1} steps; see `retroflex bench rt`"
    )]
    NotArrived(f64, String),
    /// The drivers did not switch.
    #[error("the drivers did not switch {0} within 1 s")]
    NotSwitched(&'static str),
}

/// Waits until the given time and returns the present time; `None` cancels the move.
pub type Wait<'a> = dyn FnMut(Seconds) -> Option<Seconds> + 'a;

/// A machine under manual control.
pub struct ManualMotion<'a> {
    machine: &'a mut dyn Machine,
    wait: &'a mut Wait<'a>,
    now: Seconds,
    pub(super) wanted_mm: [f64; 3],
    last: Option<Sensed>,
}

impl<'a> ManualMotion<'a> {
    /// Takes control of a machine before its first cycle. For a simulation `wait` returns at once.
    pub fn new(machine: &'a mut dyn Machine, wait: &'a mut Wait<'a>) -> Self {
        // a previous program may have left the drivers energised
        machine.energise(false);
        Self {
            machine,
            wait,
            now: Seconds(0.0),
            wanted_mm: [0.0; 3],
            last: None,
        }
    }

    /// Counts and positions of the pistons.
    pub(super) fn drive(&self) -> Drive {
        let step_mm = self.machine.info().step_mm;
        Drive { step_mm }
    }

    /// Counted positions, mm.
    pub fn stands_mm(&self) -> [f64; 3] {
        let counted = self.last.map_or(Steps::default(), |s| s.counted);
        self.drive().piston_mm(&counted).into()
    }

    fn steps(&self) -> Steps {
        self.drive().steps(&self.wanted_mm.into())
    }

    /// One cycle of the machine with all checks.
    ///
    /// # Errors
    /// [`ManualMotionError`].
    pub fn turn(&mut self) -> Result<Sensed, ManualMotionError> {
        let next = Seconds(self.now.0 + self.machine.info().period_s);
        self.now = (self.wait)(next).ok_or(ManualMotionError::Cancelled)?;
        let sensed = self.machine.turn(self.now, &self.steps())?;
        self.last = Some(sensed);
        if sensed.inputs.emergency_stop {
            return Err(ManualMotionError::EmergencyStop);
        }
        match sensed.alarm {
            // at these speeds an underrun is only a short pause
            None | Some(Alarm::Underrun) => Ok(sensed),
            Some(alarm) => {
                let remarks = self.machine.remarks();
                let mut of_pins = remarks.iter().filter_map(|r| r.strip_prefix("pins: "));
                let details = of_pins.next().map(str::to_owned);
                Err(ManualMotionError::Alarm { alarm, details })
            }
        }
    }

    /// Waits; `observe` receives every cycle.
    ///
    /// # Errors
    /// [`ManualMotionError`].
    pub fn stand(
        &mut self,
        seconds: f64,
        observe: &mut dyn FnMut(&Sensed),
    ) -> Result<(), ManualMotionError> {
        let until_s = self.now.0 + seconds;
        while self.now.0 < until_s {
            observe(&self.turn()?);
        }
        Ok(())
    }

    /// Switches the drivers and waits until they have switched.
    ///
    /// # Errors
    /// [`ManualMotionError`].
    pub fn energise(&mut self, on: bool) -> Result<(), ManualMotionError> {
        self.machine.energise(on);
        let until_s = self.now.0 + SWITCH_MAX_S;
        while self.now.0 < until_s {
            if self.turn()?.energised == on {
                return Ok(());
            }
        }
        let switch = if on { "on" } else { "off" };
        Err(ManualMotionError::NotSwitched(switch))
    }

    /// Moves to `target_mm`; `speed_mm_s` is the speed of the channel with the longest way. The move ends early when
    /// `enough` returns true.
    ///
    /// # Errors
    /// [`ManualMotionError`].
    pub fn go(
        &mut self,
        target_mm: [f64; 3],
        speed_mm_s: f64,
        enough: &mut dyn FnMut(&Sensed) -> bool,
    ) -> Result<(), ManualMotionError> {
        let from_mm = Vector3::from(self.wanted_mm);
        let to_go_mm = Vector3::from(target_mm) - from_mm;
        let way_mm = to_go_mm.amax();
        let began_s = self.now.0;
        loop {
            let share = if way_mm > 0.0 {
                ((self.now.0 - began_s) * speed_mm_s / way_mm).min(1.0)
            } else {
                1.0
            };
            self.wanted_mm = (from_mm + to_go_mm * share).into();
            let sensed = self.turn()?;
            if enough(&sensed) {
                self.wanted_mm = self.stands_mm();
                return self.arrive(enough);
            }
            if share >= 1.0 {
                return self.arrive(enough);
            }
        }
    }

    /// Waits until the counts reach the request; `enough` receives every cycle.
    fn arrive(&mut self, enough: &mut dyn FnMut(&Sensed) -> bool) -> Result<(), ManualMotionError> {
        let until_s = self.now.0 + ARRIVE_MAX_S;
        while self.now.0 < until_s {
            let sensed = self.turn()?;
            enough(&sensed);
            if sensed.counted == self.steps() {
                return Ok(());
            }
        }
        let stands = format!("{:?}", self.last.map_or([0; 3], |s| s.counted.0));
        Err(ManualMotionError::NotArrived(ARRIVE_MAX_S, stands))
    }

    /// Assigns other counts to the present position of the pistons.
    ///
    /// # Errors
    /// [`ManualMotionError::NotArrived`] if the machine does not report the new counts.
    pub fn recount(&mut self, counted: Steps) -> Result<(), ManualMotionError> {
        self.machine.recount(&counted);
        self.wanted_mm = self.drive().piston_mm(&counted).into();
        self.arrive(&mut |_| false)
    }
}
