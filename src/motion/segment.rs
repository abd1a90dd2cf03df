//! A tick's worth of motion: for each channel the state at both ends and the constant-jerk pieces
//! between. This is what the loop hands on: exact, self-contained and of fixed size.

use crate::motion::state::MotionState;

/// Most pieces a channel can need in one segment: two of braking into the limits, seven of the
/// profile and one of rest.
pub const PIECES_MAX: usize = 10;

/// One channel's part of a segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelSegment {
    /// State at the start.
    pub start: MotionState,
    /// State at the end; the next segment starts here, to the bit.
    pub end: MotionState,
    pieces: [(f64, f64); PIECES_MAX],
    len: usize,
}

impl ChannelSegment {
    /// An empty segment at a state.
    #[inline]
    #[must_use]
    pub fn starting(start: MotionState) -> Self {
        Self { start, end: start, pieces: [(0.0, 0.0); PIECES_MAX], len: 0 }
    }

    /// Standing still for a time.
    #[must_use]
    pub fn holding(position_mm: f64, duration_s: f64) -> Self {
        let mut c = Self::starting(MotionState::rest(position_mm));
        c.push(duration_s, 0.0);
        c
    }

    /// Appends a piece of `duration_s` at constant jerk; nothing if it lasts no time.
    ///
    /// More than [`PIECES_MAX`] pieces cannot arise from a plan; a further one would lengthen the
    /// last, and the end state given to [`ChannelSegment::ending`] still rules the step count.
    #[inline]
    pub fn push(&mut self, duration_s: f64, jerk_mm_s3: f64) {
        if duration_s <= 0.0 {
            return;
        }
        if self.len < PIECES_MAX {
            self.pieces[self.len] = (duration_s, jerk_mm_s3);
            self.len += 1;
        } else {
            self.pieces[PIECES_MAX - 1].0 += duration_s;
        }
    }

    /// The same with its end state.
    #[inline]
    #[must_use]
    pub fn ending(mut self, end: MotionState) -> Self {
        self.end = end;
        self
    }

    /// Duration, s, and jerk, mm/s³, of the pieces in order.
    #[inline]
    #[must_use]
    pub fn pieces(&self) -> &[(f64, f64)] {
        &self.pieces[..self.len]
    }

    /// The state `t_s` after the start (the end state from the end on).
    #[must_use]
    pub fn at(&self, t_s: f64) -> MotionState {
        let mut state = self.start;
        let mut left = t_s;
        for &(d, jerk) in self.pieces() {
            if left < d {
                return state.after(jerk, left.max(0.0));
            }
            state = state.after(jerk, d);
            left -= d;
        }
        self.end
    }

    /// True when the channel stands still from start to end.
    #[inline]
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.start.is_rest() && self.end == self.start
    }
}

/// A tick's worth of motion of all three channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// How long it lasts, s.
    pub duration_s: f64,
    /// The channels.
    pub channels: [ChannelSegment; 3],
}

impl Segment {
    /// Standing still for a time.
    #[must_use]
    pub fn holding(position_mm: [f64; 3], duration_s: f64) -> Self {
        Self { duration_s, channels: position_mm.map(|p| ChannelSegment::holding(p, duration_s)) }
    }

    /// States of the three channels at the start.
    #[must_use]
    pub fn start(&self) -> [MotionState; 3] {
        self.channels.map(|c| c.start)
    }

    /// States of the three channels at the end.
    #[must_use]
    pub fn end(&self) -> [MotionState; 3] {
        self.channels.map(|c| c.end)
    }

    /// Piston positions at the end, mm: all that a simulation needs.
    #[must_use]
    pub fn end_mm(&self) -> [f64; 3] {
        self.channels.map(|c| c.end.position_mm)
    }

    /// True when no channel moves.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.channels.iter().all(ChannelSegment::is_still)
    }
}
