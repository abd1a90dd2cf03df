//! One tick of motion: for each channel the states at both ends and the constant-jerk pieces between
//! them. A segment is exact, self-contained and of fixed size, so it can cross threads in a ring.

use crate::motion::MotionState;

/// Most pieces of one channel in a segment: two of braking into the limits, seven of the profile and
/// one of rest.
pub const PIECES_MAX: usize = 10;

/// One channel's part of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChannelSegment {
    /// State at the start.
    pub start: MotionState,
    /// State at the end. The next segment starts with exactly these bits.
    pub end: MotionState,
    pieces: [(f64, f64); PIECES_MAX],
    len: usize,
}

impl ChannelSegment {
    /// An empty segment at a state.
    pub fn starting(start: MotionState) -> Self {
        Self {
            start,
            end: start,
            pieces: [(0.0, 0.0); PIECES_MAX],
            len: 0,
        }
    }

    /// Rest for a time.
    pub fn holding(position_mm: f64, duration_s: f64) -> Self {
        let mut c = Self::starting(MotionState::rest(position_mm));
        c.push(duration_s, 0.0);
        c
    }

    /// Appends a piece of constant jerk; does nothing if `duration_s` is not positive.
    ///
    /// A plan never has more than [`PIECES_MAX`] pieces. A further piece would lengthen the last one;
    /// the end state given to [`ChannelSegment::ending`] would still determine the step count.
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

    /// Sets the end state.
    #[must_use]
    pub fn ending(self, end: MotionState) -> Self {
        Self { end, ..self }
    }

    /// Duration, s, and jerk, mm/s³, of the pieces in order.
    pub fn pieces(&self) -> &[(f64, f64)] {
        &self.pieces[..self.len]
    }

    /// Whether the channel is at rest at one position from start to end.
    pub fn is_still(&self) -> bool {
        self.start.is_rest() && self.end == self.start
    }
}

/// One tick of motion of all three channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Duration, s.
    pub duration_s: f64,
    /// The channels.
    pub channels: [ChannelSegment; 3],
}

impl Segment {
    /// Rest for a time.
    pub fn holding(position_mm: [f64; 3], duration_s: f64) -> Self {
        Self {
            duration_s,
            channels: position_mm.map(|p| ChannelSegment::holding(p, duration_s)),
        }
    }

    /// States of the three channels at the end.
    pub fn end(&self) -> [MotionState; 3] {
        self.channels.map(|c| c.end)
    }

    /// Whether no channel moves.
    pub fn is_still(&self) -> bool {
        self.channels.iter().all(ChannelSegment::is_still)
    }
}
