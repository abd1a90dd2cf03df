//! The queue from the loop to the step thread: a wait-free ring of segments with absolute times.
//!
//! Segments follow one another without a gap: each starts where and when the previous one ended. If
//! that chain breaks (an underrun, an order to stop, a fault), the step core brakes, comes to rest at a
//! position that it determines, and increments its *epoch*. It refuses segments of an older epoch, so
//! motion planned before the break is never resumed halfway. The loop reads the new epoch in a report,
//! restarts its motion from the reported rest position, and continues to feed.

use crate::motion::{DriveState, Segment, StepperMode, StepperReport};

/// A segment with its place in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedSegment {
    /// Epoch in which it was planned.
    pub epoch: u32,
    /// Start, ns of the monotonic clock.
    pub start_ns: u64,
    /// Duration, ns.
    pub duration_ns: u64,
    /// The motion.
    pub segment: Segment,
}

impl TimedSegment {
    /// End, ns of the monotonic clock.
    pub fn end_ns(&self) -> u64 {
        self.start_ns + self.duration_ns
    }
}

/// The loop's end of the ring.
#[derive(Debug)]
pub struct Feeder {
    ring: rtrb::Producer<TimedSegment>,
    lead_ns: u64,
    epoch: Option<u32>,
    next_start_ns: u64,
}

/// A ring for `capacity` segments. The first segment of an epoch starts `lead_ns` ahead of the clock.
pub fn ring(capacity: usize, lead_ns: u64) -> (Feeder, rtrb::Consumer<TimedSegment>) {
    let (ring, consumer) = rtrb::RingBuffer::new(capacity);
    let feeder = Feeder {
        ring,
        lead_ns,
        epoch: None,
        next_start_ns: 0,
    };
    (feeder, consumer)
}

impl Feeder {
    /// Begins an epoch: the next segment starts one lead from now.
    pub fn begin(&mut self, epoch: u32, now_ns: u64) {
        self.epoch = Some(epoch);
        self.next_start_ns = now_ns + self.lead_ns;
    }

    /// What a report requires before the next segment: nothing, or a reset of the motion, which was interrupted, to these rest positions,
    /// mm. A step core at rest in another epoch begins it here.
    ///
    /// # Errors
    /// The state of a drive that must feed nothing.
    pub fn sync(
        &mut self,
        report: &StepperReport,
        now_ns: u64,
    ) -> Result<Option<[f64; 3]>, DriveState> {
        match report.mode {
            StepperMode::Faulted(fault) => Err(DriveState::Faulted(fault)),
            _ if self.epoch == Some(report.epoch) => Ok(None),
            StepperMode::Resting => {
                self.begin(report.epoch, now_ns);
                Ok(Some(report.rest_mm))
            }
            StepperMode::Following | StepperMode::Stopping => Err(DriveState::Busy),
        }
    }

    /// Time by which the queued motion extends past `now_ns`, ns; negative after an underrun.
    pub fn lead_ns(&self, now_ns: u64) -> i64 {
        self.next_start_ns as i64 - now_ns as i64
    }

    /// Queues a segment directly after the previous one.
    ///
    /// A segment that starts at rest need not join the previous one. If less than half the lead
    /// remains, it is moved to a full lead, so a loop that paused at rest can start again.
    ///
    /// Returns false if the ring is full or no epoch has begun; then the segment was not queued and the start time of the next
    /// one is unchanged.
    pub fn push(&mut self, segment: &Segment, now_ns: u64) -> bool {
        let Some(epoch) = self.epoch else {
            return false;
        };
        let from_rest = segment.channels.iter().all(|c| c.start.is_rest());
        if from_rest && self.next_start_ns < now_ns + self.lead_ns / 2 {
            self.next_start_ns = now_ns + self.lead_ns;
        }
        let duration_ns = (segment.duration_s * 1e9).round() as u64;
        let timed = TimedSegment {
            epoch,
            start_ns: self.next_start_ns,
            duration_ns,
            segment: *segment,
        };
        let queued = self.ring.push(timed).is_ok();
        self.next_start_ns += if queued { duration_ns } else { 0 };
        queued
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::segment::ChannelSegment;
    use crate::motion::state::MotionState;

    fn moving() -> Segment {
        let start = MotionState {
            velocity_mm_s: 1.0,
            ..MotionState::rest(0.0)
        };
        Segment {
            duration_s: 1e-3,
            channels: [ChannelSegment::starting(start); 3],
        }
    }

    #[test]
    fn segments_join_without_a_gap() {
        let (mut feeder, mut ring) = ring(8, 4_000_000);
        feeder.begin(7, 100);
        for _ in 0..3 {
            assert!(feeder.push(&moving(), 100));
        }
        let starts: Vec<_> = std::iter::from_fn(|| ring.pop().ok())
            .map(|s| (s.epoch, s.start_ns))
            .collect();
        assert_eq!(starts, [(7, 4_000_100), (7, 5_000_100), (7, 6_000_100)]);
        assert_eq!(feeder.lead_ns(1_000_100), 6_000_000);
    }

    #[test]
    fn a_segment_from_rest_moves_to_a_full_lead_and_a_moving_one_does_not() {
        let (mut feeder, mut ring) = ring(8, 4_000_000);
        feeder.begin(0, 0);
        assert!(feeder.push(&Segment::holding([0.0; 3], 1e-3), 0));
        assert!(feeder.push(&moving(), 50_000_000));
        assert!(feeder.push(&Segment::holding([0.0; 3], 1e-3), 50_000_000));
        let starts: Vec<_> = std::iter::from_fn(|| ring.pop().ok())
            .map(|s| s.start_ns)
            .collect();
        assert_eq!(starts, [4_000_000, 5_000_000, 54_000_000]);
    }

    #[test]
    fn a_full_ring_refuses_a_segment_and_keeps_its_time() {
        let (mut feeder, _ring) = ring(1, 0);
        assert!(!feeder.push(&moving(), 0), "no epoch has begun");
        feeder.begin(0, 0);
        assert!(feeder.push(&moving(), 0));
        assert!(!feeder.push(&moving(), 0), "the ring is full");
        assert_eq!(feeder.lead_ns(0), 1_000_000);
    }
}
