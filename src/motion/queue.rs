//! The road from the loop to the step thread: a wait-free ring of segments with absolute times.
//!
//! Segments follow one another without a gap: each starts where and when the last one ended. When
//! that chain breaks (the ring ran dry, a stop was ordered, a fault) the step core brakes, comes to
//! rest somewhere of its own choosing and raises its *epoch*. Segments of an older epoch are refused,
//! so motion that was planned before the break can never be resumed in the middle. The loop sees the
//! new epoch in a report, starts its motion from the reported rest position and feeds on.

use crate::motion::segment::Segment;

/// A segment with its place in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedSegment {
    /// The epoch it was planned in.
    pub epoch: u32,
    /// When it starts, ns of the monotonic clock.
    pub start_ns: u64,
    /// How long it lasts, ns.
    pub duration_ns: u64,
    /// What is to be done.
    pub segment: Segment,
}

impl TimedSegment {
    /// When it ends, ns of the monotonic clock.
    #[must_use]
    pub fn end_ns(&self) -> u64 {
        self.start_ns + self.duration_ns
    }
}

/// Where the step core takes its segments from.
pub trait Source {
    /// The next segment, if there is one already. Never waits.
    fn next_segment(&mut self) -> Option<TimedSegment>;
}

impl Source for rtrb::Consumer<TimedSegment> {
    fn next_segment(&mut self) -> Option<TimedSegment> {
        self.pop().ok()
    }
}

impl Source for std::collections::VecDeque<TimedSegment> {
    fn next_segment(&mut self) -> Option<TimedSegment> {
        self.pop_front()
    }
}

/// Why a segment was not queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FeedError {
    /// The ring is full: the step thread does not take what it is given.
    #[error("the step queue is full: the step thread has stopped taking segments")]
    Full,
    /// No epoch was begun yet.
    #[error("feeding has not begun: wait for the step thread to report where it rests")]
    NotBegun,
}

/// The loop's end of the ring.
#[derive(Debug)]
pub struct Feeder {
    ring: rtrb::Producer<TimedSegment>,
    lead_ns: u64,
    begun: Option<u32>,
    next_start_ns: u64,
}

/// A ring for `capacity` segments; `lead_ns` is how far ahead of the clock feeding begins.
#[must_use]
pub fn ring(capacity: usize, lead_ns: u64) -> (Feeder, rtrb::Consumer<TimedSegment>) {
    let (ring, consumer) = rtrb::RingBuffer::new(capacity);
    (Feeder { ring, lead_ns, begun: None, next_start_ns: 0 }, consumer)
}

impl Feeder {
    /// Begins an epoch: the next segment starts one lead from now.
    pub fn begin(&mut self, epoch: u32, now_ns: u64) {
        self.begun = Some(epoch);
        self.next_start_ns = now_ns + self.lead_ns;
    }

    /// The epoch being fed; `None` before the first.
    #[must_use]
    pub fn epoch(&self) -> Option<u32> {
        self.begun
    }

    /// How far the queued motion reaches ahead of `now_ns`, ns; negative when it has been overtaken.
    #[must_use]
    pub fn lead_ns(&self, now_ns: u64) -> i64 {
        self.next_start_ns as i64 - now_ns as i64
    }

    /// Queues a segment right behind the last one.
    ///
    /// From rest there is no need to join on: if less than half the lead is left there, the segment
    /// is moved forward to a full lead, which is how a loop that paused at rest starts again.
    ///
    /// # Errors
    /// [`FeedError`]; the segment was not queued and time has not moved on.
    pub fn push(&mut self, segment: &Segment, now_ns: u64) -> Result<(), FeedError> {
        let Some(epoch) = self.begun else { return Err(FeedError::NotBegun) };
        let from_rest = segment.channels.iter().all(|c| c.start.is_rest());
        if from_rest && self.next_start_ns < now_ns + self.lead_ns / 2 {
            self.next_start_ns = now_ns + self.lead_ns;
        }
        let duration_ns = (segment.duration_s * 1e9).round() as u64;
        let timed = TimedSegment { epoch, start_ns: self.next_start_ns, duration_ns, segment: *segment };
        self.ring.push(timed).map_err(|_| FeedError::Full)?;
        self.next_start_ns += duration_ns;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::segment::ChannelSegment;
    use crate::motion::state::MotionState;

    fn moving() -> Segment {
        let start = MotionState { velocity_mm_s: 1.0, ..MotionState::rest(0.0) };
        Segment { duration_s: 1e-3, channels: [ChannelSegment::starting(start); 3] }
    }

    #[test]
    fn segments_join_without_a_gap() {
        let (mut feeder, mut ring) = ring(8, 4_000_000);
        feeder.begin(7, 100);
        for _ in 0..3 {
            feeder.push(&moving(), 100).unwrap();
        }
        let starts: Vec<_> = std::iter::from_fn(|| ring.next_segment()).map(|s| (s.epoch, s.start_ns)).collect();
        assert_eq!(starts, [(7, 4_000_100), (7, 5_000_100), (7, 6_000_100)]);
        assert_eq!(feeder.lead_ns(1_000_100), 6_000_000);
    }

    #[test]
    fn a_pause_at_rest_is_skipped_but_a_pause_in_motion_is_not() {
        let (mut feeder, mut ring) = ring(8, 4_000_000);
        feeder.begin(0, 0);
        feeder.push(&Segment::holding([0.0; 3], 1e-3), 0).unwrap();
        feeder.push(&moving(), 50_000_000).unwrap();
        feeder.push(&Segment::holding([0.0; 3], 1e-3), 50_000_000).unwrap();
        let starts: Vec<_> = std::iter::from_fn(|| ring.next_segment()).map(|s| s.start_ns).collect();
        assert_eq!(starts, [4_000_000, 5_000_000, 54_000_000]);
    }

    #[test]
    fn a_full_ring_refuses_and_keeps_time() {
        let (mut feeder, _ring) = ring(1, 0);
        assert_eq!(feeder.push(&moving(), 0), Err(FeedError::NotBegun));
        feeder.begin(0, 0);
        feeder.push(&moving(), 0).unwrap();
        assert_eq!(feeder.push(&moving(), 0), Err(FeedError::Full));
        assert_eq!(feeder.lead_ns(0), 1_000_000);
    }
}
