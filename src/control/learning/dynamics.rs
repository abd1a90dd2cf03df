//! Which lag and which dead time lie between piston and felt bend: a bank of models that race.
//!
//! Each candidate (τ, T) predicts the felt bend from the bend the pistons should give. Prediction `x`
//! and measurement `y` pass the same high-pass, so that creep and drift do not count, and are compared
//! up to a factor, so that a wrong gain does not either: only the shape of motion does. What is left
//! unexplained, `1 − (Σx·y)² / (Σx² Σy²)`, is gathered with slow forgetting while there is motion. The
//! best candidate is believed once enough motion was seen, it explains the motion well in itself (a tip
//! against a wall is explained by none), and it clearly beats the one in use. Multiple-model estimation
//! after Magill (1965), with unexplained energy in place of likelihoods.

use crate::control::pi::Dynamics;
use nalgebra::Vector2;

/// Lags that race, s.
pub const LAGS_S: [f64; 8] = [0.01, 0.03, 0.06, 0.12, 0.2, 0.35, 0.6, 1.0];
/// Dead times that race, s.
pub const DELAYS_S: [f64; 9] = [0.0, 0.01, 0.025, 0.05, 0.08, 0.12, 0.16, 0.21, 0.26];
/// Rate at which the bank looks, 1/s.
const RATE_HZ: f64 = 100.0;
const PERIOD_S: f64 = 1.0 / RATE_HZ;
/// Samples of history, enough for the longest dead time.
const HISTORY: usize = 32;
/// Time constant of the high-pass, s.
const HIGH_PASS_S: f64 = 0.5;
/// Forgetting time of the energies while moving, s.
const MEMORY_S: f64 = 30.0;
/// Motion (path of the high-passed prediction, rad) before anything is believed.
const COVERAGE_RAD: f64 = 2.0;
/// Unexplained share above which no candidate is believed.
const UNEXPLAINED_MAX: f64 = 0.08;
/// A candidate must leave less than this fraction of what the one in use leaves.
const BETTER: f64 = 0.8;

/// One candidate's prediction and what was gathered about it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Candidate {
    lagged: Vector2<f64>,
    slow: Vector2<f64>,
    xx: f64,
    xy: f64,
}

/// The race so far.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicsBank {
    history: [Vector2<f64>; HISTORY],
    head: usize,
    /// ∫ of the command since the bank last looked, rad·s.
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
    /// One tick with the bend the pistons should give and the felt bend, rad.
    pub fn step(&mut self, commanded: Vector2<f64>, estimate: Vector2<f64>, dt_s: f64) {
        self.due_s += dt_s;
        self.commanded += commanded * dt_s;
        if self.due_s < PERIOD_S - 1e-9 {
            return;
        }
        // a loop slower than the bank's rate still counts its real time
        let dt_s = self.due_s;
        self.due_s = 0.0;
        self.head = (self.head + 1) % HISTORY;
        // the mean over the interval, not its end: the end would be half an interval early
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

    /// The command that many intervals ago, between two of them if need be.
    fn back(&self, intervals: f64) -> Vector2<f64> {
        let whole = (intervals.floor() as usize).min(HISTORY - 2);
        let at = |n: usize| self.history[(self.head + HISTORY - n) % HISTORY];
        at(whole).lerp(&at(whole + 1), (intervals - whole as f64).min(1.0))
    }

    /// The winner, if it is to be believed rather than `now`.
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

    /// Steps of the command in many directions through a line with gain error and creep.
    fn race(truth: Dynamics, dt_s: f64) -> Option<Dynamics> {
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
            let slow = race(Dynamics { lag_s: 0.6, delay_s: 0.0 }, dt_s).unwrap();
            assert!((slow.lag_s - 0.6).abs() < 0.3, "{slow:?}");
            let late = race(Dynamics { lag_s: 0.03, delay_s: 0.16 }, dt_s).unwrap();
            assert!((late.delay_s - 0.16).abs() < 0.03, "{late:?}");
        }
    }

    #[test]
    fn a_tip_that_does_not_follow_teaches_nothing() {
        let mut bank = DynamicsBank::default();
        let mut at = Vector2::zeros();
        for k in 0..8000 {
            let phase = (f64::from(k) * 0.005 / 1.5).floor();
            let target = Vector2::new((phase * 1.3).cos(), (phase * 2.1).sin()) * 0.9;
            at += (target - at) * 0.02;
            // a wall takes all that is beyond it
            bank.step(at, at.map(|x: f64| x.clamp(-0.9, 0.1)), 0.005);
        }
        let believed = bank.best(&Dynamics { lag_s: 0.03, delay_s: 0.0 });
        assert!(believed.is_none_or(|d| d.lag_s <= 0.12), "{believed:?}");
    }

    #[test]
    fn keeps_what_is_right_and_waits_for_motion() {
        let truth = Dynamics { lag_s: 0.03, delay_s: 0.01 };
        assert_eq!(race(truth, 0.001), None);
        assert_eq!(DynamicsBank::default().best(&truth), None);
    }
}
