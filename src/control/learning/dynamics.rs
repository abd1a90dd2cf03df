//! Estimates lag and dead time between the pistons and the estimated bend with a bank of candidate models.
//!
//! Each candidate (τ, T) predicts the estimated bend from the bend that the pistons cause. Prediction `x` and measurement
//! `y` pass the same high-pass filter, which removes creep and drift, and are compared up to a factor, which removes gain
//! errors; only the shape of the motion remains. The unexplained share `1 − (Σx·y)² / (Σx² Σy²)` accumulates with slow
//! forgetting during motion. The best candidate is accepted once there was enough motion, if it explains the motion well
//! (none does for an obstructed tip) and clearly better than the candidate in use. This is multiple-model estimation
//! after Magill (1965), with unexplained energy in place of likelihoods.

use crate::control::pi::Dynamics;
use nalgebra::Vector2;

/// Lags of the candidates, s.
pub const LAGS_S: [f64; 8] = [0.01, 0.03, 0.06, 0.12, 0.2, 0.35, 0.6, 1.0];
/// Dead times of the candidates, s.
pub const DELAYS_S: [f64; 9] = [0.0, 0.01, 0.025, 0.05, 0.08, 0.12, 0.16, 0.21, 0.26];
/// Sampling rate of the bank, 1/s.
const RATE_HZ: f64 = 100.0;
const PERIOD_S: f64 = 1.0 / RATE_HZ;
/// Samples of history, enough for the longest dead time.
const HISTORY: usize = 32;
/// Time constant of the high-pass, s.
const HIGH_PASS_S: f64 = 0.5;
/// Forgetting time of the energies while moving, s.
const MEMORY_S: f64 = 30.0;
/// Path of the estimated bend required for a result, rad.
const COVERAGE_RAD: f64 = 2.0;
/// Unexplained share above which no candidate is accepted.
const UNEXPLAINED_MAX: f64 = 0.08;
/// Largest unexplained share of an accepted candidate, relative to that of the candidate in use.
const BETTER: f64 = 0.8;

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
    /// One tick with the bend from the pistons and the estimated bend, rad.
    pub fn step(&mut self, commanded: Vector2<f64>, estimate: Vector2<f64>, dt_s: f64) {
        self.due_s += dt_s;
        self.commanded += commanded * dt_s;
        if self.due_s < PERIOD_S - 1e-9 {
            return;
        }
        // a loop slower than the sampling rate counts its real period
        let dt_s = self.due_s;
        self.due_s = 0.0;
        self.head = (self.head + 1) % HISTORY;
        // the mean over the interval; the value at its end would be half an interval early
        self.history[self.head] = self.commanded / dt_s;
        self.commanded = Vector2::zeros();
        let delayed = DELAYS_S.map(|delay_s| self.back(delay_s / dt_s));
        let slow_keep = (-dt_s / HIGH_PASS_S).exp();
        self.slow_estimate = estimate + (self.slow_estimate - estimate) * slow_keep;
        let fast_estimate = estimate - self.slow_estimate;
        let path = (estimate - self.last_estimate).norm();
        self.last_estimate = estimate;
        let moving = path > 0.02 * dt_s.max(PERIOD_S);
        self.motion_rad += if moving { path } else { 0.0 };
        let forget = if moving { (-dt_s / MEMORY_S).exp() } else { 1.0 };
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
    }

    /// The command that many intervals ago, interpolated.
    fn back(&self, intervals: f64) -> Vector2<f64> {
        let whole = (intervals.floor() as usize).min(HISTORY - 2);
        let at = |n: usize| self.history[(self.head + HISTORY - n) % HISTORY];
        at(whole).lerp(&at(whole + 1), (intervals - whole as f64).min(1.0))
    }

    /// The best candidate, if it is accepted in place of `now`.
    #[must_use]
    pub fn best(&self, now: &Dynamics) -> Option<Dynamics> {
        if self.motion_rad < COVERAGE_RAD {
            return None;
        }
        let all = || (0..LAGS_S.len()).flat_map(|l| (0..DELAYS_S.len()).map(move |d| (l, d)));
        let (l, d) = all().min_by(|a, b| self.unexplained(*a).total_cmp(&self.unexplained(*b)))?;
        let gap = |x: &(usize, usize)| (LAGS_S[x.0] - now.lag_s).abs() / (0.02 + now.lag_s) + (DELAYS_S[x.1] - now.delay_s).abs() / 0.02;
        let near = all().min_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let left = self.unexplained((l, d));
        let better = left < UNEXPLAINED_MAX && left < BETTER * self.unexplained(near);
        better.then_some(Dynamics { lag_s: LAGS_S[l], delay_s: DELAYS_S[d] })
    }

    fn unexplained(&self, (l, d): (usize, usize)) -> f64 {
        let c = &self.candidates[l][d];
        let scale = c.xx * self.yy;
        if scale > 0.0 && c.xy > 0.0 { 1.0 - c.xy * c.xy / scale } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::pi::ReferenceModel;

    /// Best candidate after steps in many directions, through a line with gain error and creep.
    fn best_for(truth: Dynamics, dt_s: f64) -> Option<Dynamics> {
        let (mut bank, mut plant) = (DynamicsBank::default(), ReferenceModel::default());
        let (mut at, mut crept) = (Vector2::zeros(), Vector2::zeros());
        for k in 0..(40.0 / dt_s) as usize {
            let phase = (k as f64 * dt_s / 1.5).floor();
            let target = Vector2::new((phase * 1.3).cos(), (phase * 2.1).sin()) * 0.7;
            let step: Vector2<f64> = target - at;
            let size = step.norm();
            at += if size > 1.5 * dt_s { step * (1.5 * dt_s / size) } else { step };
            let estimate = plant.step(at, &truth, dt_s);
            crept += (estimate * 0.1 - crept) * (dt_s / 5.0);
            bank.step(at, estimate * 0.9 + crept, dt_s);
        }
        bank.best(&Dynamics { lag_s: 0.03, delay_s: 0.01 })
    }

    #[test]
    fn finds_slow_lines_and_dead_times() {
        for dt_s in [0.001, 0.005] {
            let slow = best_for(Dynamics { lag_s: 0.6, delay_s: 0.0 }, dt_s).unwrap();
            assert!((slow.lag_s - 0.6).abs() < 0.3, "{slow:?}");
            let late = best_for(Dynamics { lag_s: 0.03, delay_s: 0.16 }, dt_s).unwrap();
            assert!((late.delay_s - 0.16).abs() < 0.03, "{late:?}");
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
        let found = bank.best(&Dynamics { lag_s: 0.03, delay_s: 0.0 });
        assert!(found.is_none_or(|d| d.lag_s <= 0.12), "{found:?}");
    }

    #[test]
    fn keeps_correct_dynamics_and_requires_motion() {
        let truth = Dynamics { lag_s: 0.03, delay_s: 0.01 };
        assert_eq!(best_for(truth, 0.001), None);
        assert_eq!(DynamicsBank::default().best(&truth), None);
    }
}
