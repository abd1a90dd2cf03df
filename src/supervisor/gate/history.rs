//! Counts sent during the last ticks, and the speeds that follow from them.
//!
//! The speed is the mean over a window of W ticks and the acceleration the change between two consecutive windows:
//! `v = (n_k − n_{k−W})/W`, `a = (v_k − v_{k−W})/W`, with the true duration of each tick. Both have the resolution of
//! one microstep, which [`Quotient::exceeds`] allows for.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "NaN exceeds every limit")]

use crate::primitives::units::Steps;

/// Ticks of one window.
const WINDOW: usize = 16;

/// The counts of two windows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct History {
    step_mm: f64,
    /// Counts sent; the newest is at `head`.
    sent: [Steps; 2 * WINDOW],
    /// Duration of each tick, s.
    took_s: [f64; 2 * WINDOW],
    head: usize,
}

impl History {
    /// Pistons that have rested at `at` for both windows.
    pub(super) fn resting(at: &Steps, step_mm: f64, tick_s: f64) -> Self {
        Self { step_mm, sent: [*at; 2 * WINDOW], took_s: [tick_s; 2 * WINDOW], head: 0 }
    }

    /// The counts sent last.
    pub(super) fn newest(&self) -> Steps {
        self.sent[self.head]
    }

    /// Appends the counts of a tick of `dt_s`.
    pub(super) fn push(&mut self, steps: Steps, dt_s: f64) {
        self.head = (self.head + 1) % self.sent.len();
        self.sent[self.head] = steps;
        self.took_s[self.head] = dt_s.max(0.0);
    }

    /// Speeds over the last window, mm/s.
    pub(super) fn speed_mm_s(&self) -> [f64; 3] {
        let window_s = self.took(0, WINDOW);
        let (now, then) = (self.newest(), self.sent[self.back(WINDOW)]);
        std::array::from_fn(|i| f64::from(now.0[i] - then.0[i]) * self.step_mm / window_s)
    }

    /// Speed and acceleration of channel `i` if `wanted` were sent after `dt_s`, in mm/s and mm/s².
    pub(super) fn motion(&self, i: usize, wanted: i32, dt_s: f64) -> (Quotient, Quotient) {
        let (mid, old) = (self.back(WINDOW - 1), self.back(2 * WINDOW - 1));
        let mm = |a: i32, b: i32| (f64::from(a) - f64::from(b)) * self.step_mm;
        let now_s = dt_s + self.took(0, WINDOW - 1);
        let then_s = self.took(WINDOW - 1, 2 * WINDOW - 1);
        let (now, then) = (mm(wanted, self.sent[mid].0[i]) / now_s, mm(self.sent[mid].0[i], self.sent[old].0[i]) / then_s);
        let (now_resolution, then_resolution) = (self.step_mm / now_s, self.step_mm / then_s);
        let between_s = (now_s + then_s) / 2.0;
        let speed = Quotient { value: now, resolution: now_resolution };
        (speed, Quotient { value: (now - then) / between_s, resolution: (now_resolution + then_resolution) / between_s })
    }

    fn back(&self, ticks: usize) -> usize {
        (self.head + self.sent.len() - ticks) % self.sent.len()
    }

    /// Duration of the ticks from `from` to before `to` ticks ago, s.
    fn took(&self, from: usize, to: usize) -> f64 {
        (from..to).map(|k| self.took_s[self.back(k)]).sum()
    }
}

/// A quotient of counts and the value of one count in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quotient {
    value: f64,
    resolution: f64,
}

impl Quotient {
    /// True if the value exceeds `limit` by more than its resolution, or is not a number.
    pub(super) fn exceeds(self, limit: f64) -> bool {
        !(self.value.abs() - self.resolution <= limit)
    }
}
