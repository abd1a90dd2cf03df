//! From exact motion to exact step instants.
//!
//! The count of a channel is `round(p / step)`: it changes where the position passes the middle
//! between two microsteps, `(n + ½) step`. A constant-jerk piece is cut at its turning points into
//! monotone parts; over a part from p_a to p_b the count goes from where it is to `round(p_b/step)`,
//! one step at a time, each at the root of `p(t) = (n + ½) step` in that part.
//!
//! So nothing can be lost or doubled: the steps of a part are the difference of two integers, and the
//! count itself is the only memory. Rounding can shift an instant by less than a nanosecond, never
//! the number of steps.

use crate::motion::segment::{ChannelSegment, Segment};
use crate::motion::state::MotionState;

/// One step of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// When, s from the start of the segment.
    pub t_s: f64,
    /// +1 elongates, −1 contracts.
    pub direction: i32,
}

/// Count of a position: the nearest microstep, halves away from zero.
#[inline]
#[must_use]
pub fn count(position_mm: f64, step_mm: f64) -> i32 {
    // Saturates far outside any travel; a position that is no number counts as zero.
    (position_mm / step_mm).round() as i32
}

/// Produces the steps of one channel, segment after segment.
#[derive(Debug, Clone)]
pub struct ChannelSteps {
    step_mm: f64,
    /// Steps produced since zero, signed: the position that was asked for, in steps.
    count: i32,
    segment: ChannelSegment,
    /// Piece in hand, its start state and start time.
    piece: usize,
    at: MotionState,
    at_s: f64,
    /// Monotone part in hand, s from the start of the piece, and the count at its end.
    part: (f64, f64),
    part_count: i32,
    done: bool,
}

impl ChannelSteps {
    /// At rest at a count.
    #[must_use]
    pub fn new(step_mm: f64, count: i32) -> Self {
        let segment = ChannelSegment::starting(MotionState::rest(f64::from(count) * step_mm));
        Self { step_mm, count, segment, piece: 0, at: segment.start, at_s: 0.0, part: (0.0, 0.0), part_count: count, done: true }
    }

    /// The count after the last step produced.
    #[must_use]
    pub fn count(&self) -> i32 {
        self.count
    }

    /// Declares the count, dropping what is left of the segment.
    pub fn reset(&mut self, count: i32) {
        *self = Self::new(self.step_mm, count);
    }

    /// Takes up the next segment. Steps of the last one not yet produced are produced at its start.
    pub fn load(&mut self, segment: &ChannelSegment) {
        self.segment = *segment;
        self.piece = 0;
        self.at = segment.start;
        self.at_s = 0.0;
        self.part = (0.0, 0.0);
        // A part of no length at the start: whatever the count lacks falls due there.
        self.part_count = count(segment.start.position_mm, self.step_mm);
        self.done = segment.is_still() && self.part_count == self.count;
    }

    /// The next step of the segment, or `None` at its end.
    pub fn next_step(&mut self) -> Option<Step> {
        while !self.done {
            if self.count != self.part_count {
                return Some(self.step());
            }
            self.next_part();
        }
        None
    }

    /// One step towards the end of the part in hand.
    fn step(&mut self) -> Step {
        let direction = if self.part_count > self.count { 1 } else { -1 };
        let middle_mm = (f64::from(self.count) + 0.5 * f64::from(direction)) * self.step_mm;
        let jerk = self.segment.pieces().get(self.piece).map_or(0.0, |p| p.1);
        let t_s = passing(&self.at, jerk, self.part, middle_mm);
        self.part.0 = t_s;
        self.count += direction;
        Step { t_s: self.at_s + t_s, direction }
    }

    /// Moves to the next monotone part, over piece boundaries; sets `done` behind the last.
    fn next_part(&mut self) {
        let Some(&(duration_s, jerk)) = self.segment.pieces().get(self.piece) else {
            // What the chain of pieces and the end state differ by, if anything, falls due here.
            self.part_count = count(self.segment.end.position_mm, self.step_mm);
            self.done = self.count == self.part_count;
            return;
        };
        if self.part.1 >= duration_s {
            self.at = self.at.after(jerk, duration_s);
            self.at_s += duration_s;
            self.piece += 1;
            self.part = (0.0, 0.0);
            return;
        }
        let from = self.part.1;
        let until = self.at.turns(jerk, duration_s).as_slice().iter().copied().find(|&t| t > from).unwrap_or(duration_s);
        self.part = (from, until);
        self.part_count = count(self.knot_mm(jerk, until, duration_s), self.step_mm);
    }

    /// Position at the end of a part; at the end of the segment it is the end state's own.
    fn knot_mm(&self, jerk: f64, until_s: f64, duration_s: f64) -> f64 {
        if until_s >= duration_s && self.piece + 1 == self.segment.pieces().len() {
            self.segment.end.position_mm
        } else {
            self.at.after(jerk, until_s).position_mm
        }
    }
}

/// When a monotone part passes a position, s from the start of the piece.
///
/// Newton's method kept inside a shrinking bracket; bisection whenever it would leave it or is slow.
/// A position outside the part (by rounding) gives the nearer end.
fn passing(at: &MotionState, jerk: f64, part: (f64, f64), middle_mm: f64) -> f64 {
    let (mut low, mut high) = part;
    let short = |t: f64| at.after(jerk, t).position_mm - middle_mm;
    let (gap_low, gap_high) = (short(low), short(high));
    if gap_low * gap_high >= 0.0 {
        return if gap_low.abs() < gap_high.abs() { low } else { high };
    }
    let rising = gap_high > 0.0;
    let mut t = low + (high - low) * (gap_low / (gap_low - gap_high));
    for _ in 0..60 {
        let s = at.after(jerk, t);
        let gap = s.position_mm - middle_mm;
        if (gap > 0.0) == rising {
            high = t;
        } else {
            low = t;
        }
        let mut next = t - gap / s.velocity_mm_s;
        if !(next > low && next < high) {
            next = 0.5 * (low + high);
        }
        // a tenth of a nanosecond
        if (next - t).abs() < 1e-10 {
            return next;
        }
        t = next;
    }
    t
}

/// The steps of all three channels of a segment that starts at an absolute time.
#[derive(Debug, Clone)]
pub struct StepStream {
    channels: [ChannelSteps; 3],
    pending: [Option<Step>; 3],
    start_ns: u64,
}

impl StepStream {
    /// At rest at given counts.
    #[must_use]
    pub fn new(step_mm: f64, counts: [i32; 3]) -> Self {
        Self { channels: counts.map(|c| ChannelSteps::new(step_mm, c)), pending: [None; 3], start_ns: 0 }
    }

    /// Takes up a segment that starts at `start_ns` of the monotonic clock.
    pub fn load(&mut self, segment: &Segment, start_ns: u64) {
        self.start_ns = start_ns;
        for (i, (steps, s)) in self.channels.iter_mut().zip(&segment.channels).enumerate() {
            steps.load(s);
            self.pending[i] = steps.next_step();
        }
    }

    /// When the next step of a channel is due, ns, and its direction.
    #[inline]
    #[must_use]
    pub fn peek(&self, channel: usize) -> Option<(u64, i32)> {
        self.pending[channel].map(|s| (self.start_ns + (s.t_s * 1e9).round() as u64, s.direction))
    }

    /// Takes the step last peeked at.
    pub fn take(&mut self, channel: usize) {
        self.pending[channel] = self.channels[channel].next_step();
    }

    /// True when no step of the segment is left.
    #[must_use]
    pub fn is_spent(&self) -> bool {
        self.pending.iter().all(Option::is_none)
    }

    /// Declares counts, dropping what is left.
    pub fn reset(&mut self, counts: [i32; 3]) {
        for (i, c) in counts.into_iter().enumerate() {
            self.channels[i].reset(c);
            self.pending[i] = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cruise_steps_evenly() {
        let start = MotionState { velocity_mm_s: 10.0, ..MotionState::rest(0.0) };
        let mut seg = ChannelSegment::starting(start);
        seg.push(1.0, 0.0);
        let seg = seg.ending(MotionState { position_mm: 10.0, ..start });
        let mut c = ChannelSteps::new(0.1, 0);
        c.load(&seg);
        for n in 0..100 {
            let s = c.next_step().unwrap();
            assert!((s.t_s - (f64::from(n) + 0.5) * 0.01).abs() < 1e-9, "{n} {s:?}");
            assert_eq!(s.direction, 1);
        }
        assert_eq!((c.next_step(), c.count()), (None, 100));
    }

    /// Up and down again within one piece: the turn is between the two passings of each middle.
    #[test]
    fn a_turn_inside_a_piece_steps_up_and_down() {
        let start = MotionState { velocity_mm_s: 10.0, acceleration_mm_s2: -20.0, position_mm: 0.0 };
        let mut seg = ChannelSegment::starting(start);
        seg.push(1.0, 0.0);
        let seg = seg.ending(start.after(0.0, 1.0));
        let mut c = ChannelSteps::new(0.1, 0);
        c.load(&seg);
        let steps: Vec<Step> = std::iter::from_fn(|| c.next_step()).collect();
        assert_eq!(steps.iter().map(|s| s.direction).sum::<i32>(), 0);
        assert_eq!(steps.len(), 50);
        assert!(steps[..25].iter().all(|s| s.direction == 1 && s.t_s < 0.5));
        assert!(steps[25..].iter().all(|s| s.direction == -1 && s.t_s > 0.5));
    }

    #[test]
    fn a_still_segment_has_no_steps() {
        let mut c = ChannelSteps::new(0.1, 30);
        c.load(&ChannelSegment::holding(3.0, 1.0));
        assert_eq!(c.next_step(), None);
    }

    #[test]
    fn steps_left_over_fall_due_at_the_start_of_the_next_segment() {
        let mut c = ChannelSteps::new(0.1, 28);
        c.load(&ChannelSegment::holding(3.0, 1.0));
        assert_eq!(c.next_step(), Some(Step { t_s: 0.0, direction: 1 }));
        assert_eq!(c.next_step(), Some(Step { t_s: 0.0, direction: 1 }));
        assert_eq!(c.next_step(), None);
    }

    #[test]
    fn a_stream_gives_absolute_times() {
        let mut s = StepStream::new(0.1, [0; 3]);
        let start = MotionState { velocity_mm_s: 10.0, ..MotionState::rest(0.0) };
        let mut up = ChannelSegment::starting(start);
        up.push(0.02, 0.0);
        let up = up.ending(start.after(0.0, 0.02));
        let still = ChannelSegment::holding(0.0, 0.02);
        s.load(&Segment { duration_s: 0.02, channels: [still, up, still] }, 1_000_000_000);
        assert_eq!((s.peek(0), s.peek(1)), (None, Some((1_005_000_000, 1))));
        s.take(1);
        assert_eq!(s.peek(1), Some((1_015_000_000, 1)));
        s.take(1);
        assert!(s.is_spent());
    }
}
