//! The step core: what the step thread does at time t. A pure state machine.
//!
//! ```text
//!            segment                     end, at rest, none follows
//!  Resting ───────────▶ Following ─────────────────────────────────▶ Resting
//!     ▲                    │ end in motion and none follows (dry), or an order to stop
//!     │   at rest          ▼
//!     └──────────────── Stopping      a step too late, a torn segment, a pin error, the red button:
//!                                     anything ──▶ Faulted ──(order Clear)──▶ Resting
//! ```
//!
//! The shell around it does three things for ever: asks [`StepCore::poll`], then either writes the
//! levels and reports the write with [`StepCore::wrote`], or waits until the told time. Late is when
//! a step is due and the clock is [`PulseTiming::late_ns`] past it: the thread was kept from running
//! or the pins are too slow. Then nothing more is pulsed, the drivers hold, and what *was* pulsed is
//! reported; missed steps are never made up for in a burst. Up to that bound, due steps are made one
//! by one, no closer than [`PulseTiming::interval_ns`].

mod modes;

use crate::motion::config::EmergencyStop;
use crate::motion::histogram::Histogram;
use crate::motion::limits::MotionLimits;
use crate::motion::lines::{Inputs, Levels, OutputLine, PulseTiming};
use crate::motion::queue::{Source, TimedSegment};
use crate::motion::report::{StepperFault, StepperMode, StepperOrder, StepperReport};
use crate::motion::state::MotionState;
use crate::motion::steps::StepStream;
use crate::primitives::units::Steps;

/// What the shell is to do now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PulseAction {
    /// Bring the lines to these levels, then call [`StepCore::wrote`].
    Write(Levels),
    /// Nothing before this time, ns of the monotonic clock; look at inputs and orders then.
    WaitUntil(u64),
}

/// The state machine.
#[derive(Debug, Clone)]
pub struct StepCore {
    timing: PulseTiming,
    limits: MotionLimits,
    step_mm: f64,
    mode: StepperMode,
    current: Option<TimedSegment>,
    stream: StepStream,
    lines: [OutputLine; 3],
    levels: Levels,
    written: Levels,
    enable: bool,
    rewrite: bool,
    awake_ns: u64,
    moved_ns: u64,
    at: [MotionState; 3],
    counted: [i32; 3],
    epoch: u32,
    after_stop: AfterStop,
    inputs: Inputs,
    pressed: u8,
    dry: u32,
    refused: u32,
    lateness: Histogram,
    interval_error: Histogram,
    last_rise: [(u64, u64); 3],
}

/// What follows when a stop has come to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
enum AfterStop {
    Rest,
    Fault(StepperFault),
    Finish,
}

/// Consecutive readings of the emergency stop that count as pressed.
const PRESSED_READINGS: u8 = 2;
/// Steps further apart than this are not an interval of one motion, ns.
const INTERVAL_LONGEST_NS: u64 = 50_000_000;

impl StepCore {
    /// At rest at zero, drivers released.
    #[must_use]
    pub fn new(timing: PulseTiming, limits: &MotionLimits, step_mm: f64) -> Self {
        Self {
            timing,
            limits: *limits,
            step_mm,
            mode: StepperMode::Resting,
            current: None,
            stream: StepStream::new(step_mm, [0; 3]),
            lines: [OutputLine::default(); 3],
            levels: Levels::default(),
            written: Levels::default(),
            enable: false,
            rewrite: false,
            awake_ns: 0,
            moved_ns: 0,
            at: [MotionState::rest(0.0); 3],
            counted: [0; 3],
            epoch: 0,
            after_stop: AfterStop::Rest,
            inputs: Inputs::default(),
            pressed: 0,
            dry: 0,
            refused: 0,
            lateness: Histogram::default(),
            interval_error: Histogram::default(),
            last_rise: [(0, 0); 3],
        }
    }

    /// The drivers are energised already at `now_ns`, and stay so until they are told otherwise.
    #[must_use]
    pub fn found_energised(mut self, now_ns: u64) -> Self {
        self.moved_ns = now_ns;
        let on = Levels { enable: true, ..Levels::default() };
        (self.enable, self.levels, self.written) = (true, on, on);
        self
    }

    /// What to do at `now_ns`, a reading of the clock just taken.
    pub fn poll(&mut self, now_ns: u64, source: &mut impl Source) -> PulseAction {
        self.advance(now_ns, source);
        self.check_lateness(now_ns);
        self.idle(now_ns);
        if self.mode == StepperMode::Faulted(StepperFault::Pins) {
            return PulseAction::WaitUntil(now_ns + self.timing.poll_ns);
        }
        let wanted = self.wanted(now_ns);
        if wanted == self.levels && !self.rewrite {
            return PulseAction::WaitUntil(self.next_ns(now_ns));
        }
        self.written = wanted;
        PulseAction::Write(wanted)
    }

    /// The levels last asked for are on the lines; the write was over at `done_ns`.
    pub fn wrote(&mut self, done_ns: u64) {
        let (old, new) = (self.levels, self.written);
        for channel in 0..3 {
            let line = &mut self.lines[channel];
            if new.dir[channel] != old.dir[channel] {
                line.turned(new.dir[channel], done_ns, &self.timing);
            }
            match (old.step[channel], new.step[channel]) {
                (false, true) => {
                    line.rose(done_ns, &self.timing);
                    self.stepped(channel, done_ns);
                }
                (true, false) => line.fell(done_ns, &self.timing),
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

    /// The pins failed: nothing is known of them any more, so they are left alone until
    /// [`StepperOrder::Clear`], and then written whether they seem to need it or not.
    pub fn pins_failed(&mut self) {
        self.fail(StepperFault::Pins);
        self.mode = StepperMode::Faulted(StepperFault::Pins);
        self.rewrite = true;
    }

    /// The input lines as just read.
    pub fn observe(&mut self, inputs: Inputs) {
        self.pressed = if inputs.emergency_stop { self.pressed.saturating_add(1) } else { 0 };
        self.inputs = inputs;
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
            StepperOrder::Release if self.mode == StepperMode::Resting || faulted => self.enable = false,
            StepperOrder::Clear if faulted && self.pressed < PRESSED_READINGS => self.settle(),
            StepperOrder::Rebase(position_mm) if self.mode == StepperMode::Resting => self.rebase(position_mm),
            _ => {}
        }
    }

    /// True when [`StepperOrder::Finish`] has been carried out and the lines are in their last state.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        let down = !self.levels.enable && self.levels.step == [false; 3];
        let over = match self.mode {
            StepperMode::Faulted(StepperFault::Pins) => true,
            StepperMode::Resting | StepperMode::Faulted(_) => down,
            StepperMode::Following | StepperMode::Stopping => false,
        };
        self.after_stop == AfterStop::Finish && over
    }

    /// Everything worth knowing.
    #[must_use]
    pub fn report(&self, now_ns: u64) -> StepperReport {
        StepperReport {
            t_ns: now_ns,
            mode: self.mode,
            epoch: self.epoch,
            counted: Steps(self.counted),
            rest_mm: self.at.map(|s| s.position_mm),
            energised: self.levels.enable,
            inputs: self.inputs,
            dry: self.dry,
            refused: self.refused,
            lateness: self.lateness,
        }
    }

    /// What it is at.
    #[must_use]
    pub fn mode(&self) -> StepperMode {
        self.mode
    }

    /// Segments of this epoch are taken.
    #[must_use]
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// The drivers are energised.
    #[must_use]
    pub fn is_energised(&self) -> bool {
        self.levels.enable
    }

    /// Input lines as last read.
    #[must_use]
    pub fn inputs(&self) -> Inputs {
        self.inputs
    }

    /// Steps really pulsed, signed, since zero.
    #[must_use]
    pub fn counted(&self) -> Steps {
        Steps(self.counted)
    }

    /// How far the time between two steps of a channel was off the time wanted.
    #[must_use]
    pub fn interval_error(&self) -> &Histogram {
        &self.interval_error
    }

    /// A step of a channel has been pulsed.
    fn stepped(&mut self, channel: usize, done_ns: u64) {
        let Some((due_ns, direction)) = self.stream.peek(channel) else { return };
        self.stream.take(channel);
        self.counted[channel] += direction;
        self.lateness.record(done_ns.saturating_sub(due_ns));
        let (last_due_ns, last_done_ns) = self.last_rise[channel];
        let (wanted, got) = (due_ns.saturating_sub(last_due_ns), done_ns.saturating_sub(last_done_ns));
        if wanted < INTERVAL_LONGEST_NS {
            self.interval_error.record(wanted.abs_diff(got));
        }
        self.last_rise[channel] = (due_ns, done_ns);
    }

    /// A step that is due and too late is a fault.
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

    /// Releases the drivers after a long rest, if that is wanted.
    fn idle(&mut self, now_ns: u64) {
        let over = self.timing.idle_ns.is_some_and(|idle_ns| now_ns > self.moved_ns + idle_ns);
        if over && self.levels.enable && self.mode != StepperMode::Stopping && self.stream.is_spent() {
            self.enable = false;
        }
    }

    /// The levels the lines should have now. At most one line of a channel moves at a time.
    fn wanted(&self, now_ns: u64) -> Levels {
        let mut wanted = Levels { enable: self.enable, ..self.levels };
        for (channel, line) in self.lines.iter().enumerate() {
            if line.high {
                wanted.step[channel] = now_ns < line.fall_ns;
            } else if let Some((due_ns, direction)) = self.stream.peek(channel) {
                let up = direction > 0;
                if up != line.up {
                    wanted.dir[channel] = if now_ns >= line.turn_ns { up } else { line.up };
                } else if self.levels.enable && self.enable {
                    wanted.step[channel] = now_ns >= due_ns.max(line.rise_ns).max(self.awake_ns);
                }
            }
        }
        wanted
    }

    /// When there is something to do next.
    fn next_ns(&self, now_ns: u64) -> u64 {
        let mut next_ns = now_ns + self.timing.poll_ns;
        for (channel, line) in self.lines.iter().enumerate() {
            if line.high {
                next_ns = next_ns.min(line.fall_ns);
            } else if let Some((due_ns, direction)) = self.stream.peek(channel) {
                let turned = (direction > 0) == line.up;
                let ready_ns = if turned { due_ns.max(line.rise_ns).max(self.awake_ns) } else { line.turn_ns };
                next_ns = next_ns.min(ready_ns);
            }
        }
        match &self.current {
            Some(current) if self.stream.is_spent() => next_ns.min(current.end_ns()),
            _ => next_ns,
        }
    }
}
