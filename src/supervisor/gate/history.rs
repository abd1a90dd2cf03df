//! Counts that the machine reported during the last ticks, and the speeds that follow from them.
//!
//! The speed is the mean over a window of W ticks and the acceleration the change between two consecutive windows:
//! `v = (n_k − n_{k−W})/W`, `a = (v_k − v_{k−W})/W`. The time of a count is that up to which the machine has made the steps,
//! not that of the tick: a step thread that is late and catches up is not fast. Both have the resolution of one microstep,
//! which [`Quotient::exceeds`] allows for.

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "NaN exceeds every limit")]

use super::limits::GateLimits;
use crate::primitives::Steps;

/// Ticks of one window.
const WINDOW: usize = 16;

/// The counts of two windows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct History {
    step_mm: f64,
    /// Counts at both ends of each tick; the newest is at `head`.
    counted: [Steps; 2 * WINDOW + 1],
    /// Time between each count and the one before, s.
    took_s: [f64; 2 * WINDOW + 1],
    head: usize,
    /// Time since the newest count, s.
    since_s: f64,
    /// Nothing has been reported yet: the first counts are where the pistons rest.
    fresh: bool,
}

impl History {
    /// Pistons that have rested for both windows, presumably at `at`.
    pub(super) fn resting(at: &Steps, limits: &GateLimits) -> Self {
        Self {
            step_mm: limits.step_mm,
            counted: [*at; 2 * WINDOW + 1],
            took_s: [limits.tick_s; 2 * WINDOW + 1],
            head: 0,
            since_s: 0.0,
            fresh: true,
        }
    }

    /// The counts of the last tick.
    pub(super) fn newest(&self) -> Steps {
        self.counted[self.head]
    }

    /// Appends the counts after a tick of `dt_s`, which are `age_s` old; without effect if they are no newer than the last.
    pub(super) fn push(&mut self, counted: Steps, dt_s: f64, age_s: f64) {
        self.since_s += dt_s.max(0.0);
        let took_s = self.since_s - age_s;
        if took_s <= 0.0 {
            return;
        }
        self.since_s = age_s;
        if std::mem::take(&mut self.fresh) {
            self.counted = [counted; 2 * WINDOW + 1];
        }
        self.head = (self.head + 1) % self.counted.len();
        self.counted[self.head] = counted;
        self.took_s[self.head] = took_s;
    }

    /// Speed of channel `i` over the last window, mm/s.
    pub(super) fn speed(&self, i: usize) -> Quotient {
        self.mean_speed(i, 0)
    }

    /// Change of the speed of channel `i` between the last two windows, mm/s².
    pub(super) fn acceleration(&self, i: usize) -> Quotient {
        let (now, then) = (self.mean_speed(i, 0), self.mean_speed(i, WINDOW));
        let between_s = (self.took_s(0) + self.took_s(WINDOW)) / 2.0;
        Quotient {
            value: (now.value - then.value) / between_s,
            resolution: (now.resolution + then.resolution) / between_s,
        }
    }

    /// Mean speed of channel `i` over the window that ended `ago` ticks ago, mm/s.
    fn mean_speed(&self, i: usize, ago: usize) -> Quotient {
        let [end, start] =
            [ago, ago + WINDOW].map(|ticks| f64::from(self.counted[self.back(ticks)].0[i]));
        let took_s = self.took_s(ago);
        Quotient {
            value: (end - start) * self.step_mm / took_s,
            resolution: self.step_mm / took_s,
        }
    }

    fn back(&self, ticks: usize) -> usize {
        (self.head + self.counted.len() - ticks) % self.counted.len()
    }

    /// Duration of the window that ended `ago` ticks ago, s.
    fn took_s(&self, ago: usize) -> f64 {
        let window = ago..ago + WINDOW;
        window.map(|ticks| self.took_s[self.back(ticks)]).sum()
    }
}

/// A quotient of counts and the value of one count in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quotient {
    pub(super) value: f64,
    resolution: f64,
}

impl Quotient {
    /// True if the value exceeds `limit` by more than its resolution, or is not a number.
    pub(super) fn exceeds(self, limit: f64) -> bool {
        !(self.value.abs() - self.resolution <= limit)
    }
}
