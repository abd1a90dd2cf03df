//! The loop's side of motion on hardware: takes piston targets, feeds segments to the step thread and
//! returns counts.
//!
//! Every update tops the queue up to its lead. A loop that is late once catches up at the next update;
//! a loop that has stopped leaves the step thread to brake.

use crate::hardware::pins::Pins;
use crate::hardware::stepper::{StartError, Stepper, SyncStatus};
use crate::motion::lines::EmergencyStop;
use crate::motion::report::{StepperFault, StepperMode, StepperOrder, StepperReport};
use crate::motion::{Motion, MotionConfig, MotionLimits, MotionState, StepperConfig};
use crate::primitives::units::Steps;

/// Most segments queued in one update.
const TOP_UP_MAX: u32 = 16;

/// State of the drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DriveState {
    /// The drivers are off or about to be; targets are ignored.
    Off,
    /// Targets are followed.
    Ready,
    /// Braking or waiting; the target is followed later without a further call.
    Busy,
    /// Faulted until [`Drive::clear`].
    Faulted(StepperFault),
    /// The step thread has ended.
    Dead,
}

/// Motion and the handle on the step thread.
pub struct Drive {
    stepper: Stepper<Box<dyn Pins>>,
    motion: Motion,
    period_s: f64,
    lead_ns: i64,
    step_mm: f64,
    on: bool,
    /// The drivers were found energised and no order has changed that.
    keeps: bool,
    /// Positions to declare, mm, and, once that is ordered, the epoch before the order.
    rebase: Option<([f64; 3], Option<u32>)>,
    state: DriveState,
}

impl Drive {
    /// Starts the step thread with the drivers off and the pistons at zero.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(
        pins: Box<dyn Pins>,
        config: &StepperConfig,
        motion: &MotionConfig,
        step_mm: f64,
        period_s: f64,
        emergency_stop: EmergencyStop,
    ) -> Result<Self, StartError> {
        let limits = MotionLimits::try_from(motion)?;
        let stepper = Stepper::start(pins, config, motion, step_mm, emergency_stop)?;
        Ok(Self {
            keeps: stepper.is_energised(),
            stepper,
            motion: Motion::new(&limits),
            period_s,
            lead_ns: (config.lead_ms * 1e6) as i64,
            step_mm,
            on: false,
            rebase: None,
            state: DriveState::Off,
        })
    }

    /// Reads the reports of the step thread and queues motion towards `target_mm`.
    pub fn update(&mut self, now_ns: u64, target_mm: [f64; 3]) -> DriveState {
        self.state = match self.stepper.sync(now_ns) {
            SyncStatus::Dead => DriveState::Dead,
            SyncStatus::Faulted(fault) => DriveState::Faulted(fault),
            SyncStatus::Busy => DriveState::Busy,
            SyncStatus::Ready => self.feed(now_ns, target_mm),
            SyncStatus::Restart(rest_mm) => {
                self.motion.reset(rest_mm);
                self.feed(now_ns, target_mm)
            }
        };
        self.state
    }

    fn feed(&mut self, now_ns: u64, target_mm: [f64; 3]) -> DriveState {
        let pausing = !self.on || self.rebase.is_some();
        if pausing && self.motion.state().iter().all(MotionState::is_rest) {
            // Nothing more is queued; when the queue is empty, the thread rests.
            return self.pause();
        }
        for _ in 0..TOP_UP_MAX {
            if self.stepper.lead_ns(now_ns) >= self.lead_ns {
                break;
            }
            let segment = if pausing { self.motion.brake(self.period_s) } else { self.motion.tick(target_mm, self.period_s) };
            if self.stepper.feed(&segment, now_ns).is_err() {
                // A full ring means that the thread is stuck; its lateness will be a fault.
                return DriveState::Busy;
            }
        }
        if pausing { DriveState::Busy } else { DriveState::Ready }
    }

    /// Sends the orders that are valid only at rest.
    fn pause(&mut self) -> DriveState {
        let Some(&StepperReport { mode: StepperMode::Resting, epoch, energised, .. }) = self.stepper.latest() else {
            return DriveState::Busy;
        };
        match self.rebase {
            Some((position_mm, None)) => {
                if self.stepper.order(StepperOrder::Rebase(position_mm)) {
                    self.rebase = Some((position_mm, Some(epoch)));
                }
                DriveState::Busy
            }
            Some((_, Some(before))) => {
                if before != epoch {
                    self.rebase = None;
                }
                DriveState::Busy
            }
            None if energised => {
                // If the ring of orders is full, the next update tries again.
                let _ = !self.keeps && self.stepper.order(StepperOrder::Release);
                DriveState::Busy
            }
            None => DriveState::Off,
        }
    }

    /// Switches the drivers on at once, or off when the pistons rest.
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

    /// Declares the counts of the pistons as soon as they rest.
    pub fn rebase(&mut self, counted: &Steps) {
        self.rebase = Some((counted.0.map(|n| f64::from(n) * self.step_mm), None));
    }

    /// Leaves a fault whose cause has gone.
    pub fn clear(&mut self) {
        let _ = self.stepper.order(StepperOrder::Clear);
        if self.on {
            let _ = self.stepper.order(StepperOrder::Energise);
        }
    }

    /// The state after the last update.
    #[must_use]
    pub fn state(&self) -> DriveState {
        self.state
    }

    /// The handle on the step thread.
    #[must_use]
    pub fn stepper(&self) -> &Stepper<Box<dyn Pins>> {
        &self.stepper
    }
}
