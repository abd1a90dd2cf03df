//! From exact motion to exact step instants.
//!
//! The step count of a channel is `round(p / step)`. It changes where the position passes the midpoint
//! between two microsteps, `(n + ½) step`. A constant-jerk piece is cut at its reversals into monotone
//! parts. Over a part from p_a to p_b the count goes from its present value to `round(p_b/step)`, one
//! step at a time, each at the root of `p(t) = (n + ½) step` in that part.
//!
//! No step can be lost or doubled: the steps of a part are the difference of two integers, and the
//! count is the only memory. Rounding can shift an instant by less than a nanosecond but cannot change
//! the number of steps.

use crate::motion::{ChannelSegment, MotionState, Segment};

/// One step of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Time, s from the start of the segment.
    pub t_s: f64,
    /// +1 elongates, −1 contracts.
    pub direction: i32,
}

/// Step count of a position: the nearest microstep, halves away from zero.
pub fn count(position_mm: f64, step_mm: f64) -> i32 {
    // The conversion saturates far outside any travel, and NaN counts as zero.
    (position_mm / step_mm).round() as i32
}

/// Produces the steps of one channel, segment after segment.
#[derive(Debug, Clone, Default)]
pub struct ChannelSteps {
    step_mm: f64,
    /// Steps produced since zero, signed.
    count: i32,
    segment: ChannelSegment,
    /// Index, start state and start time of the present piece.
    piece: usize,
    at: MotionState,
    at_s: f64,
    /// Start and end of the present monotone part, s from the start of the piece, and the count at its
    /// end.
    part: (f64, f64),
    part_count: i32,
    done: bool,
}

impl ChannelSteps {
    /// At rest at a count.
    pub fn new(step_mm: f64, count: i32) -> Self {
        let at = MotionState::rest(f64::from(count) * step_mm);
        Self {
            step_mm,
            count,
            segment: ChannelSegment::starting(at),
            at,
            part_count: count,
            done: true,
            ..Self::default()
        }
    }

    /// Loads the next segment. Steps of the previous one that were not produced fall due at its start.
    pub fn load(&mut self, segment: &ChannelSegment) {
        // A first part of zero length makes up for steps that the count lacks.
        let part_count = count(segment.start.position_mm, self.step_mm);
        let done = segment.is_still() && part_count == self.count;
        *self = Self {
            segment: *segment,
            at: segment.start,
            part_count,
            done,
            ..Self::new(self.step_mm, self.count)
        };
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

    /// One step towards the end of the present part.
    fn step(&mut self) -> Step {
        let direction = if self.part_count > self.count { 1 } else { -1 };
        let midpoint_mm = (f64::from(self.count) + 0.5 * f64::from(direction)) * self.step_mm;
        let jerk = self.segment.pieces().get(self.piece).map_or(0.0, |p| p.1);
        let t_s = crossing_s(&self.at, jerk, self.part, midpoint_mm);
        self.part.0 = t_s;
        self.count += direction;
        Step {
            t_s: self.at_s + t_s,
            direction,
        }
    }

    /// Moves to the next monotone part, across piece boundaries; sets `done` after the last part.
    fn next_part(&mut self) {
        let Some(&(duration_s, jerk)) = self.segment.pieces().get(self.piece) else {
            // Any difference between the chain of pieces and the end state falls due here.
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
        let mut reversals = self.at.reversals(jerk, duration_s);
        let until = reversals.find(|&t| t > from).unwrap_or(duration_s);
        let is_last = until >= duration_s && self.piece + 1 == self.segment.pieces().len();
        let end = if is_last {
            self.segment.end
        } else {
            self.at.after(jerk, until)
        };
        self.part = (from, until);
        self.part_count = count(end.position_mm, self.step_mm);
    }
}

/// Time at which a monotone part crosses a position, s from the start of the piece.
///
/// Newton's method inside a shrinking bracket, with bisection whenever Newton's step leaves the
/// bracket. A position outside the part (by rounding) gives the nearer end.
fn crossing_s(at: &MotionState, jerk: f64, part: (f64, f64), position_mm: f64) -> f64 {
    let (mut low, mut high) = part;
    let gap_mm = |t: f64| at.after(jerk, t).position_mm - position_mm;
    let (gap_low, gap_high) = (gap_mm(low), gap_mm(high));
    if gap_low * gap_high >= 0.0 {
        let low_is_nearer = gap_low.abs() < gap_high.abs();
        return if low_is_nearer { low } else { high };
    }
    let rising = gap_high > 0.0;
    let mut t = low + (high - low) * (gap_low / (gap_low - gap_high));
    // Sixty bisections alone would exhaust the precision of an f64.
    for _ in 0..60 {
        let s = at.after(jerk, t);
        let gap = s.position_mm - position_mm;
        if (gap > 0.0) == rising {
            high = t;
        } else {
            low = t;
        }
        let mut next = t - gap / s.velocity_mm_s;
        if !(next > low && next < high) {
            next = 0.5 * (low + high);
        }
        // Converged to a tenth of a nanosecond.
        if (next - t).abs() < 1e-10 {
            return next;
        }
        t = next;
    }
    t
}

/// The steps of all three channels of a segment that starts at an absolute time.
#[derive(Debug, Clone, Default)]
pub struct StepStream {
    step_mm: f64,
    channels: [ChannelSteps; 3],
    pending: [Option<Step>; 3],
    start_ns: u64,
}

impl StepStream {
    /// At rest at given counts.
    pub fn new(step_mm: f64, counts: [i32; 3]) -> Self {
        Self {
            step_mm,
            channels: counts.map(|c| ChannelSteps::new(step_mm, c)),
            ..Self::default()
        }
    }

    /// Loads a segment that starts at `start_ns` of the monotonic clock.
    pub fn load(&mut self, segment: &Segment, start_ns: u64) {
        self.start_ns = start_ns;
        for (i, (steps, s)) in self.channels.iter_mut().zip(&segment.channels).enumerate() {
            steps.load(s);
            self.pending[i] = steps.next_step();
        }
    }

    /// Due time, ns, and direction of the next step of a channel.
    pub fn peek(&self, channel: usize) -> Option<(u64, i32)> {
        self.pending[channel].map(|s| (self.start_ns + (s.t_s * 1e9).round() as u64, s.direction))
    }

    /// Removes the next step of a channel.
    pub fn take(&mut self, channel: usize) {
        self.pending[channel] = self.channels[channel].next_step();
    }

    /// Whether no step of the segment is left.
    pub fn is_empty(&self) -> bool {
        self.pending.iter().all(Option::is_none)
    }

    /// Declares counts and drops the remaining steps.
    pub fn reset(&mut self, counts: [i32; 3]) {
        *self = Self::new(self.step_mm, counts);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_speed_gives_evenly_spaced_steps() {
        let start = MotionState {
            velocity_mm_s: 10.0,
            ..MotionState::rest(0.0)
        };
        let mut seg = ChannelSegment::starting(start);
        seg.push(1.0, 0.0);
        let seg = seg.ending(MotionState {
            position_mm: 10.0,
            ..start
        });
        let mut c = ChannelSteps::new(0.1, 0);
        c.load(&seg);
        for n in 0..100 {
            let s = c.next_step().unwrap();
            assert!(
                (s.t_s - (f64::from(n) + 0.5) * 0.01).abs() < 1e-9,
                "{n} {s:?}"
            );
            assert_eq!(s.direction, 1);
        }
        assert_eq!((c.next_step(), c.count), (None, 100));
    }

    /// Up and down again within one piece: the reversal lies between the two crossings of each midpoint.
    #[test]
    fn a_reversal_inside_a_piece_steps_up_and_down() {
        let start = MotionState {
            velocity_mm_s: 10.0,
            acceleration_mm_s2: -20.0,
            position_mm: 0.0,
        };
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
    fn remaining_steps_fall_due_at_the_start_of_the_next_segment() {
        let mut c = ChannelSteps::new(0.1, 28);
        c.load(&ChannelSegment::holding(3.0, 1.0));
        assert_eq!(
            c.next_step(),
            Some(Step {
                t_s: 0.0,
                direction: 1
            })
        );
        assert_eq!(
            c.next_step(),
            Some(Step {
                t_s: 0.0,
                direction: 1
            })
        );
        assert_eq!(c.next_step(), None);
    }

    #[test]
    fn a_stream_gives_absolute_times() {
        let mut s = StepStream::new(0.1, [0; 3]);
        let start = MotionState {
            velocity_mm_s: 10.0,
            ..MotionState::rest(0.0)
        };
        let mut up = ChannelSegment::starting(start);
        up.push(0.02, 0.0);
        let up = up.ending(start.after(0.0, 0.02));
        let still = ChannelSegment::holding(0.0, 0.02);
        s.load(
            &Segment {
                duration_s: 0.02,
                channels: [still, up, still],
            },
            1_000_000_000,
        );
        assert_eq!((s.peek(0), s.peek(1)), (None, Some((1_005_000_000, 1))));
        s.take(1);
        assert_eq!(s.peek(1), Some((1_015_000_000, 1)));
        s.take(1);
        assert!(s.is_empty());
    }
}
