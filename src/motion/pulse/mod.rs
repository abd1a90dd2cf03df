//! The step core: decides what the step thread does at time t. A pure state machine.
//!
//! ```text
//!            segment                     end, at rest, none follows
//!  Resting ───────────▶ Following ─────────────────────────────────▶ Resting
//!     ▲                    │ end in motion, none follows (underrun), or an order to stop
//!     │   at rest          ▼
//!     └──────────────── Stopping      a late step, a discontinuity, a pin error, the emergency stop:
//!                                     any mode ──▶ Faulted ──(order Clear)──▶ Resting
//! ```
//!
//! The surrounding thread repeats one cycle: it calls [`StepCore::poll`], then either writes the levels
//! and reports the write with [`StepCore::wrote`], or waits until the given time. A step is late if the
//! clock is [`PulseTiming::late_ns`] past its due time, because the thread did not run or the pins are
//! too slow. The core then stops pulsing, keeps the drivers energised and reports the steps that *were*
//! pulsed; it never catches up in a burst. Up to that bound it makes due steps one by one, no closer
//! than [`PulseTiming::interval_ns`].

mod modes;

use crate::motion::lines::OutputLine;
use crate::motion::queue::TimedSegment;
use crate::motion::steps::StepStream;
use crate::motion::{
    EmergencyStop, Histogram, Inputs, Levels, MotionLimits, MotionState, PulseTiming, StepperFault,
    StepperMode, StepperOrder, StepperReport,
};
use crate::primitives::Steps;

/// What the step thread must do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PulseAction {
    /// Write these levels, then call [`StepCore::wrote`].
    Write(Levels),
    /// Wait until this time, ns of the monotonic clock, then read inputs and orders.
    WaitUntil(u64),
}

/// The state machine.
#[derive(Debug, Clone, Default)]
pub struct StepCore {
    timing: PulseTiming,
    limits: MotionLimits,
    step_mm: f64,
    mode: StepperMode,
    current: Option<TimedSegment>,
    stream: StepStream,
    lines: [OutputLine; 3],
    /// Levels on the lines, and those of the write in progress.
    levels: Levels,
    written: Levels,
    /// Whether the drivers should be energised.
    enable: bool,
    /// The lines must be written even if their levels are unchanged.
    rewrite: bool,
    /// Earliest step after energising.
    awake_ns: u64,
    /// End of the last motion.
    moved_ns: u64,
    /// States of the pistons at the end of the current segment.
    at: [MotionState; 3],
    counted: [i32; 3],
    epoch: u32,
    after_stop: AfterStop,
    inputs: Inputs,
    /// Consecutive readings with the emergency stop pressed.
    pressed: u8,
    underruns: u32,
    refused: u32,
    lateness: Histogram,
    /// Deviation of the intervals between two steps of a channel from the planned intervals.
    pub interval_error: Histogram,
    /// Due time and actual time of the last step of each channel.
    last_step_ns: [(u64, u64); 3],
}

/// What follows a completed stop.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
enum AfterStop {
    #[default]
    Rest,
    Fault(StepperFault),
    Finish,
}

/// Consecutive readings of the emergency stop that count as pressed; one may be a disturbance.
const PRESSED_READINGS: u8 = 2;
/// Steps farther apart than this are not an interval of one motion, ns.
const INTERVAL_LONGEST_NS: u64 = 50_000_000;

impl StepCore {
    /// At rest at zero with the drivers released.
    pub fn new(timing: PulseTiming, limits: &MotionLimits, step_mm: f64) -> Self {
        Self {
            timing,
            limits: *limits,
            step_mm,
            stream: StepStream::new(step_mm, [0; 3]),
            ..Self::default()
        }
    }

    /// The same with drivers that are already energised at `now_ns` and stay so until an order.
    #[must_use]
    pub fn found_energised(mut self, now_ns: u64) -> Self {
        self.moved_ns = now_ns;
        let on = Levels::without_step(true);
        (self.enable, self.levels, self.written) = (true, on, on);
        self
    }

    /// The action at `now_ns`, a fresh reading of the clock. `next` takes the next segment from the
    /// queue and never waits.
    pub fn poll(
        &mut self,
        now_ns: u64,
        next: &mut impl FnMut() -> Option<TimedSegment>,
    ) -> PulseAction {
        self.advance(now_ns, next);
        self.check_lateness(now_ns);
        self.release_when_idle(now_ns);
        if self.mode == StepperMode::Faulted(StepperFault::Pins) {
            return PulseAction::WaitUntil(now_ns + self.timing.poll_ns);
        }
        let desired = self.desired_levels(now_ns);
        if desired == self.levels && !self.rewrite {
            return PulseAction::WaitUntil(self.next_ns(now_ns));
        }
        self.written = desired;
        PulseAction::Write(desired)
    }

    /// Records that the levels of the last [`PulseAction::Write`] are on the lines since `done_ns`.
    pub fn wrote(&mut self, done_ns: u64) {
        let (old, new) = (self.levels, self.written);
        for channel in 0..3 {
            let line = &mut self.lines[channel];
            if new.dir[channel] != old.dir[channel] {
                line.dir_changed(new.dir[channel], done_ns, &self.timing);
            }
            match (old.step[channel], new.step[channel]) {
                (false, true) => {
                    line.step_rose(done_ns, &self.timing);
                    self.count_step(channel, done_ns);
                }
                (true, false) => line.step_fell(done_ns, &self.timing),
                _ => {}
            }
        }
        if new.enable && !old.enable {
            self.awake_ns = done_ns + self.timing.wake_ns;
            self.moved_ns = self.moved_ns.max(done_ns);
        }
        self.levels = new;
        self.rewrite = false;
    }

    /// Records a failure of the pins. Their state is unknown, so they are not touched until
    /// [`StepperOrder::Clear`] and are then written unconditionally.
    pub fn pins_failed(&mut self) {
        self.fail(StepperFault::Pins);
        self.mode = StepperMode::Faulted(StepperFault::Pins);
        self.rewrite = true;
    }

    /// Takes a reading of the input lines.
    pub fn observe(&mut self, inputs: Inputs) {
        self.inputs = inputs;
        self.pressed = if inputs.emergency_stop {
            self.pressed.saturating_add(1)
        } else {
            0
        };
        if self.pressed < PRESSED_READINGS {
            return;
        }
        match self.timing.emergency_stop {
            EmergencyStop::Release => {
                self.fail(StepperFault::EmergencyStop);
                self.enable = false;
            }
            EmergencyStop::Hold if matches!(self.mode, StepperMode::Faulted(_)) => {}
            EmergencyStop::Hold => self.stop(AfterStop::Fault(StepperFault::EmergencyStop)),
        }
    }

    /// Takes an order of the loop.
    pub fn order(&mut self, order: StepperOrder) {
        let faulted = matches!(self.mode, StepperMode::Faulted(_));
        match order {
            StepperOrder::Stop if !faulted => self.stop(AfterStop::Rest),
            StepperOrder::Finish if !faulted => self.stop(AfterStop::Finish),
            StepperOrder::Finish => {
                self.enable = false;
                self.after_stop = AfterStop::Finish;
            }
            StepperOrder::Energise if !faulted => self.enable = true,
            StepperOrder::Release if self.mode == StepperMode::Resting || faulted => {
                self.enable = false
            }
            StepperOrder::Clear if faulted && self.pressed < PRESSED_READINGS => self.clear(),
            StepperOrder::Rebase(position_mm) if self.mode == StepperMode::Resting => {
                self.rebase(position_mm)
            }
            _ => {}
        }
    }

    /// Whether [`StepperOrder::Finish`] is complete and the lines are in their final state.
    pub fn is_finished(&self) -> bool {
        let released = !self.levels.enable && self.levels.step == [false; 3];
        let ended = match self.mode {
            StepperMode::Faulted(StepperFault::Pins) => true,
            StepperMode::Resting | StepperMode::Faulted(_) => released,
            StepperMode::Following | StepperMode::Stopping => false,
        };
        self.after_stop == AfterStop::Finish && ended
    }

    /// The state at `now_ns`.
    pub fn report(&self, now_ns: u64) -> StepperReport {
        StepperReport {
            t_ns: now_ns,
            mode: self.mode,
            epoch: self.epoch,
            counted: Steps(self.counted),
            complete_ns: (0..3)
                .filter_map(|i| self.stream.peek(i))
                .fold(now_ns, |t_ns, (due_ns, _)| t_ns.min(due_ns)),
            rest_mm: self.at.map(|s| s.position_mm),
            energised: self.levels.enable,
            inputs: self.inputs,
            underruns: self.underruns,
            refused: self.refused,
            lateness: self.lateness,
        }
    }

    /// Counts a pulsed step of a channel.
    fn count_step(&mut self, channel: usize, done_ns: u64) {
        let Some((due_ns, direction)) = self.stream.peek(channel) else {
            return;
        };
        self.stream.take(channel);
        self.counted[channel] += direction;
        self.lateness.record(done_ns.saturating_sub(due_ns));
        let (last_due_ns, last_done_ns) = self.last_step_ns[channel];
        let planned = due_ns.saturating_sub(last_due_ns);
        let actual = done_ns.saturating_sub(last_done_ns);
        if planned < INTERVAL_LONGEST_NS {
            self.interval_error.record(planned.abs_diff(actual));
        }
        self.last_step_ns[channel] = (due_ns, done_ns);
    }

    /// Raises a fault if a due step is too late.
    fn check_lateness(&mut self, now_ns: u64) {
        for channel in 0..3 {
            if let Some((due_ns, _)) = self.stream.peek(channel) {
                let late_ns = now_ns.saturating_sub(due_ns.max(self.awake_ns));
                if late_ns > self.timing.late_ns {
                    self.fail(StepperFault::Late { channel, late_ns });
                    return;
                }
            }
        }
    }

    /// Releases the drivers after the configured time at rest.
    fn release_when_idle(&mut self, now_ns: u64) {
        let idle_ns = self.timing.idle_ns;
        let over = idle_ns.is_some_and(|idle_ns| now_ns > self.moved_ns + idle_ns);
        let moves = self.mode == StepperMode::Stopping || !self.stream.is_empty();
        if over && self.levels.enable && !moves {
            self.enable = false;
        }
    }

    /// The levels that the lines should have now. At most one line of a channel changes at a time.
    fn desired_levels(&self, now_ns: u64) -> Levels {
        let mut desired = Levels {
            enable: self.enable,
            ..self.levels
        };
        for (channel, line) in self.lines.iter().enumerate() {
            if line.step_high {
                desired.step[channel] = now_ns < line.fall_ns;
            } else if let Some((due_ns, direction)) = self.stream.peek(channel) {
                let up = direction > 0;
                if up != line.dir_high {
                    let may_change = now_ns >= line.dir_ns;
                    desired.dir[channel] = if may_change { up } else { line.dir_high };
                } else if self.levels.enable && self.enable {
                    desired.step[channel] = now_ns >= due_ns.max(line.rise_ns).max(self.awake_ns);
                }
            }
        }
        desired
    }

    /// The time of the next possible action.
    fn next_ns(&self, now_ns: u64) -> u64 {
        let mut next_ns = now_ns + self.timing.poll_ns;
        for (channel, line) in self.lines.iter().enumerate() {
            if line.step_high {
                next_ns = next_ns.min(line.fall_ns);
            } else if let Some((due_ns, direction)) = self.stream.peek(channel) {
                next_ns = next_ns.min(if (direction > 0) == line.dir_high {
                    due_ns.max(line.rise_ns).max(self.awake_ns)
                } else {
                    line.dir_ns
                });
            }
        }
        match &self.current {
            Some(current) if self.stream.is_empty() => next_ns.min(current.end_ns()),
            _ => next_ns,
        }
    }
}
