//! The loop's side of motion on hardware: piston targets in, segments to the step thread, counts back.
//!
//! Every turn tops the queue up to its lead, so a loop that comes late once is on time again at once,
//! and one that stays away leaves the step thread to brake by itself.

use crate::hardware::pins::Pins;
use crate::hardware::stepper::{StartError, Stepper, Sync};
use crate::motion::report::{StepperFault, StepperMode, StepperOrder, StepperReport};
use crate::motion::{Motion, MotionConfig, MotionLimits, MotionState, StepperConfig};
use crate::primitives::units::Steps;

/// Most segments queued in one turn.
const TOP_UP_MAX: u32 = 16;

/// What the drive is at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DriveState {
    /// Drivers off, or about to be: targets are ignored.
    Off,
    /// Follows targets.
    Ready,
    /// Braking or waiting: the target is taken up by itself later.
    Busy,
    /// At a fault until [`Drive::clear`].
    Faulted(StepperFault),
    /// The step thread is gone.
    Dead,
}

/// Motion and the handle on the step thread.
#[derive(Debug)]
pub struct Drive<P = Box<dyn Pins>> {
    stepper: Stepper<P>,
    motion: Motion,
    period_s: f64,
    lead_ns: i64,
    step_mm: f64,
    on: bool,
    /// Drivers that were found energised stay so until somebody decides.
    keeps: bool,
    /// Positions to declare, and once they are ordered the epoch that must pass.
    rebase: Option<([f64; 3], Option<u32>)>,
    state: DriveState,
}

impl<P: Pins + 'static> Drive<P> {
    /// Starts the step thread on these pins, drivers off, pistons called zero.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(pins: P, stepper: &StepperConfig, motion: &MotionConfig, step_mm: f64, period_s: f64) -> Result<Self, StartError> {
        let limits = MotionLimits::try_from(motion)?;
        let stepper_handle = Stepper::start(pins, stepper, motion, step_mm)?;
        Ok(Self {
            keeps: stepper_handle.is_energised(),
            stepper: stepper_handle,
            motion: Motion::new(&limits),
            period_s,
            lead_ns: (stepper.lead_ms * 1e6) as i64,
            step_mm,
            on: false,
            rebase: None,
            state: DriveState::Off,
        })
    }
}

impl<P> Drive<P> {
    /// Takes in what the step thread reports and queues motion towards `target_mm`.
    pub fn turn(&mut self, now_ns: u64, target_mm: [f64; 3]) -> DriveState {
        self.state = match self.stepper.sync(now_ns) {
            Sync::Dead => DriveState::Dead,
            Sync::Faulted(fault) => DriveState::Faulted(fault),
            Sync::Busy => DriveState::Busy,
            sync => {
                if let Sync::Restart(rest_mm) = sync {
                    self.motion.reset(rest_mm);
                }
                self.feed(now_ns, target_mm)
            }
        };
        self.state
    }

    fn feed(&mut self, now_ns: u64, target_mm: [f64; 3]) -> DriveState {
        let rests = self.motion.state().iter().all(MotionState::is_rest);
        let pausing = !self.on || self.rebase.is_some();
        if pausing && rests {
            // nothing more is queued; when the queue is worked off the thread rests
            return self.pause();
        }
        for _ in 0..TOP_UP_MAX {
            if self.stepper.lead_ns(now_ns) >= self.lead_ns {
                break;
            }
            let segment = if pausing { self.motion.brake(self.period_s) } else { self.motion.tick(target_mm, self.period_s) };
            if self.stepper.feed(&segment, now_ns).is_err() {
                // the ring is full: the thread is stuck, which its lateness will tell
                return DriveState::Busy;
            }
        }
        if pausing { DriveState::Busy } else { DriveState::Ready }
    }

    /// Orders what can only be done at rest.
    fn pause(&mut self) -> DriveState {
        let Some(report) = self.stepper.latest() else { return DriveState::Busy };
        let (resting, epoch, energised) = (report.mode == StepperMode::Resting, report.epoch, report.energised);
        if !resting {
            return DriveState::Busy;
        }
        if let Some((position_mm, ordered)) = self.rebase {
            match ordered {
                None => {
                    if self.stepper.order(StepperOrder::Rebase(position_mm)) {
                        self.rebase = Some((position_mm, Some(epoch)));
                    }
                }
                Some(before) if before != epoch => self.rebase = None,
                Some(_) => {}
            }
            return DriveState::Busy;
        }
        // a full ring of orders is tried again on the next turn
        let _ = energised && !self.keeps && self.stepper.order(StepperOrder::Release);
        if energised { DriveState::Busy } else { DriveState::Off }
    }

    /// Switches the drivers: on at once, off when the pistons rest.
    pub fn energise(&mut self, on: bool) {
        self.keeps = false;
        if on && !self.on {
            let _ = self.stepper.order(StepperOrder::Energise);
        }
        self.on = on;
        if !on && matches!(self.state, DriveState::Faulted(_)) {
            let _ = self.stepper.order(StepperOrder::Release);
        }
    }

    /// Declares where the pistons are, as soon as they rest.
    pub fn rebase(&mut self, counted: &Steps) {
        self.rebase = Some((counted.0.map(|n| f64::from(n) * self.step_mm), None));
    }

    /// Leaves a fault, as far as its cause is gone.
    pub fn clear(&mut self) {
        let _ = self.stepper.order(StepperOrder::Clear);
        if self.on {
            let _ = self.stepper.order(StepperOrder::Energise);
        }
    }

    /// What the last turn came to.
    #[must_use]
    pub fn state(&self) -> DriveState {
        self.state
    }

    /// What the step thread reported last; `None` before its first report.
    #[must_use]
    pub fn report(&self) -> Option<&StepperReport> {
        self.stepper.latest()
    }

    /// The handle itself.
    #[must_use]
    pub fn stepper(&self) -> &Stepper<P> {
        &self.stepper
    }
}
