//! Estimates lag and dead time between the pistons and the estimated bend with a bank of candidate models.
//!
//! Each candidate (τ, T) predicts the estimated bend from the bend that the pistons cause. Prediction `x` and measurement
//! `y` pass the same high-pass filter, which removes creep and drift, and are compared up to a factor, which removes gain
//! errors; only the shape of the motion remains. The unexplained share `1 − (Σx·y)² / (Σx² Σy²)` accumulates with slow
//! forgetting during motion. This is multiple-model estimation after Magill (1965), with unexplained energy in place of
//! likelihoods: a path of the tip of 0.05 rad counts as one independent observation whose variance is the
//! unexplained share of the best candidate.
//!
//! The result is not only the best candidate but also the range of candidates that remain plausible: what the observer learns
//! during motion, and how long it waits for an answer, follow from it. The range is wide at first and narrows as the tip moves.

use super::PERIOD_S;
use crate::control::dynamics::{Dynamics, DynamicsPrior, DynamicsRange};
use crate::primitives::SURE_SIGMAS;
use nalgebra::Vector2;

/// Lags of the candidates, s.
pub const LAGS_S: [f64; 13] = [
    0.01, 0.03, 0.06, 0.1, 0.14, 0.19, 0.25, 0.32, 0.41, 0.52, 0.66, 0.83, 1.05,
];
/// Dead times of the candidates, s.
pub const DELAYS_S: [f64; 16] = [
    0.0, 0.01, 0.025, 0.05, 0.08, 0.11, 0.14, 0.17, 0.2, 0.24, 0.28, 0.32, 0.37, 0.43, 0.5, 0.6,
];

crate::constants! {
    /// How the bank compares, and what it concludes.
    const BANK: BankConstants;
    /// Time constant of the high-pass, s.
    high_pass_s = 0.5;
    /// Forgetting time of the energies while moving, s.
    memory_s = 30.0;
    /// Path of the tip that counts as one independent observation, rad.
    path_per_row_rad = 0.05;
    /// Largest number of independent observations, so that an error of the model is not taken for certainty.
    rows_max = 60.0;
    /// Unexplained share that the form of the models alone leaves.
    share_floor = 0.005;
    /// Unexplained share of the best candidate above which the motion says nothing about lag and dead time, because an obstacle or a
    /// fault shapes it.
    unexplained_max = 0.35;
    /// The share above which the motion makes no further candidate plausible.
    explained_max = 0.1;
    /// The candidate in use is replaced when another is better by this much in −2 ln L.
    better = 1.0;
}

/// Samples of history, enough for the longest dead time.
const HISTORY: usize = 64;

/// Prediction and energies of one candidate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Candidate {
    lagged: Vector2<f64>,
    slow: Vector2<f64>,
    xx: f64,
    xy: f64,
}

/// The bank of candidates.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicsBank {
    history: [Vector2<f64>; HISTORY],
    head: usize,
    /// ∫ of the command since the last sample, rad·s.
    commanded: Vector2<f64>,
    candidates: [[Candidate; DELAYS_S.len()]; LAGS_S.len()],
    yy: f64,
    slow_estimate: Vector2<f64>,
    last_estimate: Vector2<f64>,
    motion_rad: f64,
    due_s: f64,
}

impl Default for DynamicsBank {
    fn default() -> Self {
        Self {
            history: [Vector2::zeros(); HISTORY],
            head: 0,
            commanded: Vector2::zeros(),
            candidates: Default::default(),
            yy: 0.0,
            slow_estimate: Vector2::zeros(),
            last_estimate: Vector2::zeros(),
            motion_rad: 0.0,
            due_s: 0.0,
        }
    }
}

impl DynamicsBank {
    /// One tick with the bend from the pistons and the estimated bend, rad; true if the tip moved since the last sample.
    pub fn step(&mut self, commanded: Vector2<f64>, estimate: Vector2<f64>, dt_s: f64) -> bool {
        self.due_s += dt_s;
        self.commanded += commanded * dt_s;
        if self.due_s < PERIOD_S - 1e-9 {
            return false;
        }
        // a loop slower than the sampling rate counts its real period
        let dt_s = self.due_s;
        self.due_s = 0.0;
        self.head = (self.head + 1) % HISTORY;
        // the mean over the interval; the value at its end would be half an interval early
        self.history[self.head] = self.commanded / dt_s;
        self.commanded = Vector2::zeros();
        let delayed = DELAYS_S.map(|delay_s| self.back(delay_s / dt_s));
        let slow_keep = (-dt_s / BANK.high_pass_s).exp();
        self.slow_estimate = estimate + (self.slow_estimate - estimate) * slow_keep;
        let fast_estimate = estimate - self.slow_estimate;
        let path = (estimate - self.last_estimate).norm();
        self.last_estimate = estimate;
        let moving = path > 0.02 * dt_s.max(PERIOD_S);
        self.motion_rad += if moving { path } else { 0.0 };
        let forget = if moving {
            (-dt_s / BANK.memory_s).exp()
        } else {
            1.0
        };
        self.yy = self.yy * forget + fast_estimate.norm_squared() * dt_s;
        for (row, &lag_s) in self.candidates.iter_mut().zip(&LAGS_S) {
            let keep = (-dt_s / lag_s).exp();
            for (c, delayed) in row.iter_mut().zip(&delayed) {
                c.lagged = delayed + (c.lagged - delayed) * keep;
                c.slow = c.lagged + (c.slow - c.lagged) * slow_keep;
                let fast = c.lagged - c.slow;
                c.xx = c.xx * forget + fast.norm_squared() * dt_s;
                c.xy = c.xy * forget + fast.dot(&fast_estimate) * dt_s;
            }
        }
        moving
    }

    /// The command that many intervals ago, interpolated.
    fn back(&self, intervals: f64) -> Vector2<f64> {
        let whole = (intervals.floor() as usize).min(HISTORY - 2);
        let at = |n: usize| self.history[(self.head + HISTORY - n) % HISTORY];
        at(whole).lerp(&at(whole + 1), (intervals - whole as f64).min(1.0))
    }

    /// Lag and dead time with what remains plausible, from the motion so far and the range `before` any motion. The
    /// candidate in use stays in use unless another is clearly better.
    pub fn assess(&self, before: &DynamicsPrior, now: &DynamicsRange) -> DynamicsRange {
        let share = self.unexplained_least();
        if share > BANK.unexplained_max {
            return *now;
        }
        let rows = (self.motion_rad / BANK.path_per_row_rad).min(BANK.rows_max);
        let rows = rows / (share + BANK.share_floor);
        let score = |c| rows * self.unexplained(c) + before.distance_squared(&candidate(c));
        let scored = all().map(|c| (c, score(c)));
        let none = ((0, 0), f64::INFINITY);
        let (best, least) = scored.fold(none, |a, b| if b.1 < a.1 { b } else { a });
        let mut range = DynamicsRange {
            best: now.best,
            response_min_s: f64::INFINITY,
            response_max_s: 0.0,
        };
        if score(nearest(&now.best)) > least + BANK.better {
            range.best = self.interpolated(best);
        }
        // −2 ln L
        let plausible = SURE_SIGMAS * SURE_SIGMAS;
        for c in all().filter(|c| score(*c) < least + plausible) {
            // a candidate stands for everything up to half of the way to its neighbours
            let (lag_s, delay_s) = (cell(&LAGS_S, c.0), cell(&DELAYS_S, c.1));
            range.response_min_s = range.response_min_s.min(lag_s[0] + delay_s[0]);
            range.response_max_s = range.response_max_s.max(lag_s[1] + delay_s[1]);
        }
        // what no candidate explains, such as a wall, makes none of them likelier
        if share > BANK.explained_max && range.error_max_s() > now.error_max_s() {
            return *now;
        }
        range
    }

    fn unexplained_least(&self) -> f64 {
        all().map(|c| self.unexplained(c)).fold(1.0, f64::min)
    }

    /// Lag and dead time between the candidates: the dead time that leaves least for each lag, then the lag.
    fn interpolated(&self, (l, d): (usize, usize)) -> Dynamics {
        let delay = |l: usize| vertex(&DELAYS_S, d, |d| self.unexplained((l, d)));
        let last = LAGS_S.len() - 1;
        let left = |l: &usize| delay(*l).1;
        let near = l.saturating_sub(1)..=(l + 1).min(last);
        let least = near.min_by(|a, b| left(a).total_cmp(&left(b)));
        let l = least.unwrap_or(l);
        let (lag_s, _) = vertex(&LAGS_S, l, |l| delay(l).1);
        // a longer lag goes with a shorter dead time
        let other = if lag_s < LAGS_S[l] {
            l.saturating_sub(1)
        } else {
            (l + 1).min(last)
        };
        let mut delay_s = delay(l).0;
        if other != l {
            let part = (lag_s - LAGS_S[l]) / (LAGS_S[other] - LAGS_S[l]);
            delay_s += part * (delay(other).0 - delay(l).0);
        }
        Dynamics {
            lag_s,
            delay_s: delay_s.max(0.0),
        }
    }

    fn unexplained(&self, (l, d): (usize, usize)) -> f64 {
        let c = &self.candidates[l][d];
        let scale = c.xx * self.yy;
        if scale > 0.0 && c.xy > 0.0 {
            1.0 - c.xy * c.xy / scale
        } else {
            1.0
        }
    }
}

/// Indices of all candidates.
fn all() -> impl Iterator<Item = (usize, usize)> {
    (0..LAGS_S.len()).flat_map(|l| (0..DELAYS_S.len()).map(move |d| (l, d)))
}

fn candidate((l, d): (usize, usize)) -> Dynamics {
    Dynamics {
        lag_s: LAGS_S[l],
        delay_s: DELAYS_S[d],
    }
}

/// Where the parabola through the values at `i` and its neighbours in the grid is least, no further than the neighbours, and the
/// value there.
fn vertex(grid: &[f64], i: usize, value: impl Fn(usize) -> f64) -> (f64, f64) {
    let least = value(i);
    if i == 0 || i + 1 == grid.len() {
        return (grid[i], least);
    }
    let (x0, x2) = (grid[i - 1] - grid[i], grid[i + 1] - grid[i]);
    let (s0, s2) = ((value(i - 1) - least) / x0, (value(i + 1) - least) / x2);
    let curvature = (s2 - s0) / (x2 - x0);
    let slope = s0 - curvature * x0;
    let shift = if curvature > 0.0 {
        (-slope / (2.0 * curvature)).clamp(x0, x2)
    } else {
        0.0
    };
    (grid[i] + shift, least + (slope + curvature * shift) * shift)
}

/// Half of the way from a value of a grid to its neighbours on both sides.
fn cell(grid: &[f64], i: usize) -> [f64; 2] {
    [i.saturating_sub(1), (i + 1).min(grid.len() - 1)].map(|j| (grid[i] + grid[j]) / 2.0)
}

/// The candidate nearest to the given dynamics.
fn nearest(to: &Dynamics) -> (usize, usize) {
    let index = |grid: &[f64], x: f64| {
        let gap = |i: &usize| (grid[*i] - x).abs();
        let nearest = (0..grid.len()).min_by(|a, b| gap(a).total_cmp(&gap(b)));
        nearest.unwrap_or(0)
    };
    (index(&LAGS_S, to.lag_s), index(&DELAYS_S, to.delay_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dead time, then a first-order lag.
    #[derive(Default)]
    struct Plant {
        line: std::collections::VecDeque<Vector2<f64>>,
        lagged: Vector2<f64>,
    }

    impl Plant {
        fn step(&mut self, at: Vector2<f64>, truth: &Dynamics, dt_s: f64) -> Vector2<f64> {
            self.line.push_back(at);
            while self.line.len() > (truth.delay_s / dt_s).round() as usize + 1 {
                self.line.pop_front();
            }
            let delayed = self.line[0];
            self.lagged = delayed + (self.lagged - delayed) * (-dt_s / truth.lag_s.max(1e-4)).exp();
            self.lagged
        }
    }

    /// What an unknown line is known to be after steps in many directions, through a line with gain error and creep.
    fn range_for(truth: Dynamics, seconds: f64, dt_s: f64) -> DynamicsRange {
        let (mut bank, mut plant) = (DynamicsBank::default(), Plant::default());
        let (mut at, mut crept) = (Vector2::zeros(), Vector2::zeros());
        for k in 0..(seconds / dt_s) as usize {
            let phase = (k as f64 * dt_s / 1.5).floor();
            let target = Vector2::new((phase * 1.3).cos(), (phase * 2.1).sin()) * 0.7;
            let step: Vector2<f64> = target - at;
            let size = step.norm();
            at += if size > 1.5 * dt_s {
                step * (1.5 * dt_s / size)
            } else {
                step
            };
            let estimate = plant.step(at, &truth, dt_s);
            crept += (estimate * 0.1 - crept) * (dt_s / 5.0);
            bank.step(at, estimate * 0.9 + crept, dt_s);
        }
        bank.assess(&UNKNOWN, &UNKNOWN.range())
    }

    const UNKNOWN: DynamicsPrior = DynamicsPrior {
        expected: Dynamics {
            lag_s: 0.03,
            delay_s: 0.01,
        },
        uncertainty_s: 0.3,
    };

    #[test]
    fn finds_slow_lines_and_dead_times() {
        for dt_s in [0.001, 0.005] {
            let slow = range_for(
                Dynamics {
                    lag_s: 0.6,
                    delay_s: 0.0,
                },
                40.0,
                dt_s,
            );
            assert!((slow.best.lag_s - 0.6).abs() < 0.3, "{slow:?}");
            let late = range_for(
                Dynamics {
                    lag_s: 0.03,
                    delay_s: 0.16,
                },
                40.0,
                dt_s,
            );
            assert!((late.best.delay_s - 0.16).abs() < 0.02, "{late:?}");
            let both = range_for(
                Dynamics {
                    lag_s: 0.35,
                    delay_s: 0.3,
                },
                40.0,
                dt_s,
            );
            assert!((both.best.response_s() - 0.65).abs() < 0.1, "{both:?}");
        }
    }

    #[test]
    fn the_plausible_range_contains_the_truth_and_narrows_with_motion() {
        for truth in [
            Dynamics {
                lag_s: 0.03,
                delay_s: 0.01,
            },
            Dynamics {
                lag_s: 0.05,
                delay_s: 0.22,
            },
            Dynamics {
                lag_s: 0.3,
                delay_s: 0.1,
            },
        ] {
            let mut before = UNKNOWN.range();
            for seconds in [1.0, 3.0, 12.0] {
                let range = range_for(truth, seconds, 0.001);
                // the grid of candidates has steps of up to 0.06 s there
                let inside = range.response_min_s - 0.06..range.response_max_s + 0.06;
                assert!(
                    inside.contains(&truth.response_s()),
                    "{truth:?} after {seconds} s: {range:?}"
                );
                assert!(
                    range.error_max_s() <= before.error_max_s() + 0.03,
                    "{truth:?} after {seconds} s: {range:?}"
                );
                before = range;
            }
            assert!(
                before.error_max_s() < 0.2 * UNKNOWN.range().error_max_s(),
                "{truth:?}: {before:?}"
            );
        }
    }

    #[test]
    fn an_obstructed_tip_does_not_change_the_dynamics() {
        let mut bank = DynamicsBank::default();
        let mut at = Vector2::zeros();
        for k in 0..8000 {
            let phase = (f64::from(k) * 0.005 / 1.5).floor();
            let target = Vector2::new((phase * 1.3).cos(), (phase * 2.1).sin()) * 0.9;
            at += (target - at) * 0.02;
            // an obstacle limits the bend
            bank.step(at, at.map(|x: f64| x.clamp(-0.9, 0.1)), 0.005);
        }
        let found = bank.assess(&UNKNOWN, &UNKNOWN.range());
        assert!(found.best.lag_s <= 0.12, "{found:?}");
    }

    #[test]
    fn correct_dynamics_stay_and_a_tip_at_rest_says_nothing() {
        let truth = Dynamics {
            lag_s: 0.03,
            delay_s: 0.01,
        };
        assert!(
            (range_for(truth, 40.0, 0.001).best.response_s() - truth.response_s()).abs() < 0.01
        );
        assert_eq!(
            DynamicsBank::default().assess(&UNKNOWN, &UNKNOWN.range()),
            UNKNOWN.range()
        );
    }
}
