//! Transitions between the modes of the step core: loading segments, underrun, stop, fault, restart.
//! The diagram is in [`super`].

use super::{AfterStop, StepCore};
use crate::motion::plan::Plan;
use crate::motion::queue::TimedSegment;
use crate::motion::steps::count;
use crate::motion::{MotionState, Segment, StepperFault, StepperMode};

/// Tolerance of the joint between two segments, mm: rounding of a chain of cubics.
const JOINT_TOLERANCE_MM: f64 = 1e-6;

impl StepCore {
    /// Continues with the next segment when the current one ends, or brakes if there is none.
    pub(super) fn advance(&mut self, now_ns: u64, next: &mut impl FnMut() -> Option<TimedSegment>) {
        loop {
            if matches!(self.mode, StepperMode::Faulted(_)) {
                while next().is_some() {
                    self.refused += 1;
                }
                return;
            }
            let end_ns = self.current.as_ref().map(TimedSegment::end_ns);
            if end_ns.is_some_and(|end_ns| now_ns < end_ns || !self.stream.is_empty()) {
                return;
            }
            if end_ns.is_some() && self.mode == StepperMode::Stopping && self.is_at_rest() {
                self.finish_stop();
                continue;
            }
            if self.mode != StepperMode::Stopping
                && let Some(segment) = next()
            {
                self.accept(&segment, end_ns, now_ns);
                continue;
            }
            match end_ns {
                Some(end_ns) if !self.is_at_rest() => self.brake(end_ns),
                _ => break,
            }
        }
        self.current = None;
        match self.mode {
            StepperMode::Stopping => self.finish_stop(),
            StepperMode::Following => self.mode = StepperMode::Resting,
            StepperMode::Resting | StepperMode::Faulted(_) => {}
        }
    }

    fn is_at_rest(&self) -> bool {
        self.at.iter().all(MotionState::is_rest)
    }

    /// Loads a segment if it is of this epoch, in time and continuous; otherwise refuses it or fails.
    fn accept(&mut self, next: &TimedSegment, end_ns: Option<u64>, now_ns: u64) {
        let in_time = if self.is_at_rest() {
            let fresh = next.segment.is_still() || now_ns <= next.start_ns + self.timing.late_ns;
            fresh && next.start_ns >= end_ns.unwrap_or(0)
        } else {
            Some(next.start_ns) == end_ns
        };
        if next.epoch != self.epoch || !in_time {
            self.refused += 1;
            if next.epoch == self.epoch {
                // The new epoch tells the loop that its chain of segments is broken.
                self.epoch += 1;
            }
        } else if let Some(fault) = self.discontinuity(&next.segment) {
            self.fail(fault);
        } else {
            self.mode = StepperMode::Following;
            self.begin(*next);
        }
    }

    /// The first channel of a segment that jumps, exceeds the speed limit or is not finite.
    fn discontinuity(&self, segment: &Segment) -> Option<StepperFault> {
        // A thousandth covers the rounding of the duration to nanoseconds.
        let longest_mm =
            self.limits.speed_max_mm_s * segment.duration_s * 1.001 + JOINT_TOLERANCE_MM;
        let mut channels = segment.channels.iter().zip(&self.at).enumerate();
        channels.find_map(|(channel, (c, at))| {
            let gap_mm = c.start.position_mm - at.position_mm;
            let distance_mm = c.end.position_mm - c.start.position_mm;
            let joins = gap_mm.abs() <= JOINT_TOLERANCE_MM;
            let jump_mm = if joins { distance_mm } else { gap_mm };
            let valid = joins && distance_mm.abs() <= longest_mm;
            (!valid).then_some(StepperFault::Discontinuity { channel, jump_mm })
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

    /// Brakes from the end of the last segment. In [`StepperMode::Following`] this is an underrun.
    fn brake(&mut self, end_ns: u64) {
        if self.mode == StepperMode::Following {
            self.underruns += 1;
            self.epoch += 1;
            self.after_stop = AfterStop::Rest;
        }
        self.mode = StepperMode::Stopping;
        let plan = Plan::stopping(&self.at, &self.limits);
        // The next whole nanosecond after the end, so that the segment ends at rest.
        let duration_ns = (plan.duration_s() * 1e9) as u64 + 2;
        let segment = plan.cut(&self.at, 0.0, duration_ns as f64 * 1e-9);
        self.begin(TimedSegment {
            epoch: self.epoch,
            start_ns: end_ns,
            duration_ns,
            segment,
        });
    }

    /// Brakes from the end of the current segment on and invalidates everything queued before.
    pub(super) fn stop(&mut self, after: AfterStop) {
        if self.mode != StepperMode::Stopping {
            self.epoch += 1;
            self.after_stop = after;
            self.mode = StepperMode::Stopping;
        } else if after != AfterStop::Rest && self.after_stop != AfterStop::Finish {
            // A stop in progress can only become more final.
            self.after_stop = after;
        }
    }

    /// Completes a stop.
    fn finish_stop(&mut self) {
        self.current = None;
        self.enable &= self.after_stop != AfterStop::Finish;
        self.mode = match self.after_stop {
            AfterStop::Fault(fault) => StepperMode::Faulted(fault),
            AfterStop::Rest | AfterStop::Finish => StepperMode::Resting,
        };
    }

    /// Stops at once: no further step; the pistons are where the pulsed steps have brought them.
    pub(super) fn fail(&mut self, fault: StepperFault) {
        if !matches!(self.mode, StepperMode::Faulted(_)) {
            self.mode = StepperMode::Faulted(fault);
            self.epoch += 1;
        }
        // a thread that is to end releases the drivers whatever happens, or it would never end
        self.enable &= self.after_stop != AfterStop::Finish;
        self.current = None;
        self.stream.reset(self.counted);
        let counted_mm = self.counted.map(|n| f64::from(n) * self.step_mm);
        self.at = counted_mm.map(MotionState::rest);
    }

    /// Leaves a fault at rest at the present count.
    pub(super) fn clear(&mut self) {
        self.mode = StepperMode::Resting;
        self.after_stop = AfterStop::Rest;
        self.epoch += 1;
    }

    /// Declares positions and the counts to which they round.
    pub(super) fn rebase(&mut self, position_mm: [f64; 3]) {
        if position_mm.iter().all(|p| p.is_finite()) {
            self.at = position_mm.map(MotionState::rest);
            self.counted = position_mm.map(|p| count(p, self.step_mm));
            self.stream.reset(self.counted);
            self.epoch += 1;
        }
    }
}
