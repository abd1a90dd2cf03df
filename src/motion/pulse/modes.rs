//! Modes of the step core and what leads from one to the next: taking up segments, running dry,
//! stopping, failing, starting again. The diagram is in [`super`].

use super::{AfterStop, StepCore};
use crate::motion::queue::{Source, TimedSegment};
use crate::motion::report::{StepperFault, StepperMode};
use crate::motion::segment::Segment;
use crate::motion::state::MotionState;
use crate::motion::steps::count;
use crate::motion::stop::stop_segment;

impl StepCore {
    /// Goes on to the segment that is due, or brakes for want of one.
    pub(super) fn advance(&mut self, now_ns: u64, source: &mut impl Source) {
        loop {
            if matches!(self.mode, StepperMode::Faulted(_)) {
                self.refuse_all(source);
                return;
            }
            let end_ns = match &self.current {
                Some(current) if now_ns < current.end_ns() || !self.stream.is_spent() => return,
                Some(current) => Some(current.end_ns()),
                None => None,
            };
            if let (Some(_), StepperMode::Stopping) = (end_ns, self.mode)
                && self.at.iter().all(MotionState::is_rest)
            {
                self.finish_stop();
                continue;
            }
            if self.mode != StepperMode::Stopping
                && let Some(next) = source.next_segment()
            {
                self.accept(&next, end_ns, now_ns);
                continue;
            }
            match end_ns {
                Some(end_ns) if !self.at.iter().all(MotionState::is_rest) => self.brake(end_ns),
                _ => {
                    self.current = None;
                    if self.mode == StepperMode::Stopping {
                        self.finish_stop();
                    }
                    self.mode = if let StepperMode::Following = self.mode { StepperMode::Resting } else { self.mode };
                    return;
                }
            }
        }
    }

    /// Takes up a segment if it is of this epoch, in time and joins on; else refuses or fails.
    fn accept(&mut self, next: &TimedSegment, end_ns: Option<u64>, now_ns: u64) {
        let in_time = if self.at.iter().all(MotionState::is_rest) {
            let fresh = next.segment.is_still() || now_ns <= next.start_ns + self.timing.late_ns;
            fresh && next.start_ns >= end_ns.unwrap_or(0)
        } else {
            Some(next.start_ns) == end_ns
        };
        if next.epoch != self.epoch || !in_time {
            self.refused += 1;
            if next.epoch == self.epoch {
                // The loop must learn that its time line is broken.
                self.epoch += 1;
            }
            return;
        }
        if let Some(fault) = self.tear(&next.segment) {
            self.fail(fault);
            return;
        }
        self.mode = StepperMode::Following;
        self.begin(*next);
    }

    /// The first channel of a segment that jumps, outruns the speed limit or is no number.
    fn tear(&self, segment: &Segment) -> Option<StepperFault> {
        let longest_mm = self.limits.speed_max_mm_s * segment.duration_s * 1.001 + 1e-6;
        segment.channels.iter().enumerate().find_map(|(channel, c)| {
            let gap_mm = c.start.position_mm - self.at[channel].position_mm;
            let way_mm = c.end.position_mm - c.start.position_mm;
            if gap_mm.abs() <= 1e-6 && way_mm.abs() <= longest_mm {
                None
            } else {
                Some(StepperFault::Discontinuity { channel, jump_mm: if gap_mm.abs() <= 1e-6 { way_mm } else { gap_mm } })
            }
        })
    }

    /// Loads a segment into the step stream.
    fn begin(&mut self, next: TimedSegment) {
        self.stream.load(&next.segment, next.start_ns);
        self.at = next.segment.end();
        if !next.segment.is_still() {
            self.enable = true;
            self.moved_ns = next.end_ns();
        }
        self.current = Some(next);
    }

    /// No segment follows although the pistons move: brake from where the last one ended.
    fn brake(&mut self, end_ns: u64) {
        if self.mode == StepperMode::Following {
            self.dry += 1;
            self.epoch += 1;
            self.after_stop = AfterStop::Rest;
        }
        self.mode = StepperMode::Stopping;
        let segment = stop_segment(&self.at, &self.limits);
        let duration_ns = (segment.duration_s * 1e9).round() as u64;
        self.begin(TimedSegment { epoch: self.epoch, start_ns: end_ns, duration_ns, segment });
    }

    /// From the end of the segment in hand on, brake; nothing queued before counts any more.
    pub(super) fn stop(&mut self, after: AfterStop) {
        if self.mode == StepperMode::Stopping {
            // A stop under way is only ever made more final.
            if after != AfterStop::Rest {
                self.after_stop = after;
            }
            return;
        }
        self.epoch += 1;
        self.after_stop = after;
        self.mode = StepperMode::Stopping;
    }

    /// A stop has come to rest.
    fn finish_stop(&mut self) {
        self.current = None;
        self.mode = match self.after_stop {
            AfterStop::Fault(fault) => StepperMode::Faulted(fault),
            AfterStop::Rest => StepperMode::Resting,
            AfterStop::Finish => {
                self.enable = false;
                StepperMode::Resting
            }
        };
    }

    /// Stops dead: no further step; what was pulsed is where the pistons are.
    pub(super) fn fail(&mut self, fault: StepperFault) {
        if !matches!(self.mode, StepperMode::Faulted(_)) {
            self.mode = StepperMode::Faulted(fault);
            self.epoch += 1;
        }
        self.current = None;
        self.stream.reset(self.counted);
        self.at = self.counted.map(|n| MotionState::rest(f64::from(n) * self.step_mm));
    }

    /// Leaves a fault, at rest where the count says.
    pub(super) fn settle(&mut self) {
        self.mode = StepperMode::Resting;
        self.after_stop = AfterStop::Rest;
        self.epoch += 1;
    }

    /// Declares positions, and the counts they round to.
    pub(super) fn rebase(&mut self, position_mm: [f64; 3]) {
        if position_mm.iter().all(|p| p.is_finite()) {
            self.at = position_mm.map(MotionState::rest);
            self.counted = position_mm.map(|p| count(p, self.step_mm));
            self.stream.reset(self.counted);
            self.epoch += 1;
        }
    }

    /// Throws away what is queued.
    fn refuse_all(&mut self, source: &mut impl Source) {
        while source.next_segment().is_some() {
            self.refused += 1;
        }
    }
}
