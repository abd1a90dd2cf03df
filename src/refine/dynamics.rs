//! Which lag and which dead time lie between piston and felt bend: a bank of models that race.
//!
//! Each candidate (τ, T) predicts the felt bend from the bend the pistons should give. Prediction and
//! measurement pass the same high-pass, so that gain errors, creep and drift do not count, only the
//! shape of motion does; the squared difference is summed with slow forgetting while there is motion.
//! The best candidate is believed once enough motion was seen and it beats the one in use clearly.
//! Multiple-model estimation after Magill (1965), with energies in place of likelihoods.

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

/// The race so far.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicsBank {
    history: [Vector2<f64>; HISTORY],
    head: usize,
    lagged: [[Vector2<f64>; DELAYS_S.len()]; LAGS_S.len()],
    slow: [[Vector2<f64>; DELAYS_S.len()]; LAGS_S.len()],
    energy: [[f64; DELAYS_S.len()]; LAGS_S.len()],
    slow_felt: Vector2<f64>,
    last_felt: Vector2<f64>,
    motion_rad: f64,
    due_s: f64,
}

impl Default for DynamicsBank {
    fn default() -> Self {
        Self {
            history: [Vector2::zeros(); HISTORY],
            head: 0,
            lagged: Default::default(),
            slow: Default::default(),
            energy: Default::default(),
            slow_felt: Vector2::zeros(),
            last_felt: Vector2::zeros(),
            motion_rad: 0.0,
            due_s: 0.0,
        }
    }
}

impl DynamicsBank {
    /// One tick with the bend the pistons should give and the felt bend, rad.
    pub fn step(&mut self, commanded: Vector2<f64>, felt: Vector2<f64>, dt_s: f64) {
        self.due_s += dt_s;
        if self.due_s < PERIOD_S - 1e-9 {
            return;
        }
        // a loop slower than the bank's rate still counts its real time
        let dt_s = self.due_s;
        self.due_s = 0.0;
        self.head = (self.head + 1) % HISTORY;
        self.history[self.head] = commanded;
        let slow_keep = (-dt_s / HIGH_PASS_S).exp();
        self.slow_felt = felt + (self.slow_felt - felt) * slow_keep;
        let fast_felt = felt - self.slow_felt;
        let path = (felt - self.last_felt).norm();
        self.last_felt = felt;
        let moving = path > 0.02 * dt_s.max(PERIOD_S);
        self.motion_rad += if moving { path } else { 0.0 };
        let forget = if moving { (-dt_s / MEMORY_S).exp() } else { 1.0 };
        for (li, &lag_s) in LAGS_S.iter().enumerate() {
            let keep = (-dt_s / lag_s).exp();
            for (di, &delay_s) in DELAYS_S.iter().enumerate() {
                let back = ((delay_s / dt_s).round() as usize).min(HISTORY - 1);
                let delayed = self.history[(self.head + HISTORY - back) % HISTORY];
                let lagged = delayed + (self.lagged[li][di] - delayed) * keep;
                let slow = lagged + (self.slow[li][di] - lagged) * slow_keep;
                self.lagged[li][di] = lagged;
                self.slow[li][di] = slow;
                let miss = (lagged - slow - fast_felt).norm_squared();
                self.energy[li][di] = self.energy[li][di] * forget + miss * dt_s;
            }
        }
    }

    /// The winner, once enough motion was seen; it must beat the candidate nearest to `now` by a
    /// tenth of the energy, else `now` stays.
    #[must_use]
    pub fn best(&self, now: &Dynamics) -> Option<Dynamics> {
        if self.motion_rad < COVERAGE_RAD {
            return None;
        }
        let all = || (0..LAGS_S.len()).flat_map(|l| (0..DELAYS_S.len()).map(move |d| (l, d)));
        let (l, d) = all().min_by(|a, b| self.energy[a.0][a.1].total_cmp(&self.energy[b.0][b.1]))?;
        let gap = |x: &(usize, usize)| (LAGS_S[x.0] - now.lag_s).abs() / (0.02 + now.lag_s) + (DELAYS_S[x.1] - now.delay_s).abs() / 0.02;
        let (nl, nd) = all().min_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let better = self.energy[l][d] < 0.9 * self.energy[nl][nd];
        better.then_some(Dynamics { lag_s: LAGS_S[l], delay_s: DELAYS_S[d] })
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
            let felt = plant.step(at, &truth, dt_s);
            crept += (felt * 0.1 - crept) * (dt_s / 5.0);
            bank.step(at, felt * 0.9 + crept, dt_s);
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
    fn keeps_what_is_right_and_waits_for_motion() {
        let truth = Dynamics { lag_s: 0.03, delay_s: 0.01 };
        assert_eq!(race(truth, 0.001), None);
        assert_eq!(DynamicsBank::default().best(&truth), None);
    }
}
