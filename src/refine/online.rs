//! Online refinement of k_ε by recursive least squares, with every guard a learner needs.
//!
//! In a held pose the slack of channel i stands at `w_i` and its bellow at `q_i`; Eq. 16 without the
//! backlash (which the play model has taken off) reads `w_i − q_i = k_ε,i q_i`: one scalar recursion
//! per channel with exponential forgetting. The guards, in order:
//!
//! 1. **Coverage.** A pose counts once: it is taken only if the tip has moved by `pose_step_rad`
//!    since the last one, and a channel only if its bellow is strained by `strain_min_mm`. Holding
//!    for an hour adds nothing, so it can neither drift nor blow the covariance up.
//! 2. **Belief.** The prior's own information is never forgotten: the information sum decays towards
//!    the prior, not towards zero.
//! 3. **Bounds.** The gain stays within `±range` of the calibrated prior.
//! 4. **Slow blend.** The gain in use follows the estimate by a bounded step a pose; the caller hands
//!    the difference over from its integrator.
//! 5. **Nonsense.** A row that is off by more than `outlier` times the spread is not learned from.

use crate::model::transmission::Line;
use nalgebra::{Vector2, Vector3};
use serde::Deserialize;

/// Guards and pace of the learner.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefineConfig {
    /// Learn at all. Default true.
    pub enabled: bool,
    /// Share of the gathered information kept per accepted pose. Default 0.99 (a memory of about 100
    /// poses). Larger remembers longer and follows a changing tip later.
    pub forgetting: f64,
    /// Worth of the calibrated prior in poses of full strain. Default 2. Larger holds the gains
    /// closer to the calibration.
    pub prior_poses: f64,
    /// Change of bend between two poses that count, degrees. Default 5. Larger learns from fewer,
    /// more different poses.
    pub pose_step_deg: f64,
    /// Least strain of a bellow for its row to count, mm. Default 1. Larger ignores gentle bends,
    /// where an offset would pass for a gain.
    pub strain_min_mm: f64,
    /// Range around the prior, as a fraction of 1 + k_ε. Default 0.5. Larger lets a worn tip be
    /// followed further, and a fault be mistaken for one.
    pub range: f64,
    /// Largest change of the gain in use per pose, as a fraction of 1 + k_ε. Default 0.04.
    pub step_max: f64,
    /// A row further from the estimate than this many spreads is not learned from. Default 4.
    pub outlier: f64,
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            forgetting: 0.99,
            prior_poses: 2.0,
            pose_step_deg: 5.0,
            strain_min_mm: 1.0,
            range: 0.5,
            step_max: 0.04,
            outlier: 4.0,
        }
    }
}

/// One channel's recursion.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    prior: f64,
    /// Σ λ^n q² with the prior's share, mm².
    information: f64,
    /// Σ λ^n q (w − q) with the prior's share, mm².
    moment: f64,
    /// Running mean square of the row error, mm².
    spread: f64,
}

/// The learner's memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefineState {
    channels: [Channel; 3],
    last_pose: Option<Vector2<f64>>,
    /// Poses learned from.
    pub poses: u32,
    /// Estimate before blending, per channel.
    pub raw: [f64; 3],
}

/// Strain at which a pose counts in full, mm.
const FULL_STRAIN_MM: f64 = 4.0;

impl RefineState {
    /// Starts at the calibrated gains.
    #[must_use]
    pub fn new(config: &RefineConfig, prior: &[Line; 3]) -> Self {
        let worth = config.prior_poses * FULL_STRAIN_MM * FULL_STRAIN_MM;
        let channel = |k: f64| Channel { prior: k, information: worth, moment: worth * k, spread: 1.0 };
        Self {
            channels: [channel(prior[0].k_epsilon), channel(prior[1].k_epsilon), channel(prior[2].k_epsilon)],
            last_pose: None,
            poses: 0,
            raw: prior.map(|l| l.k_epsilon),
        }
    }

    /// A held pose: slack and bellow positions in mm, the felt bend in rad. Returns the gains to use
    /// from now on, or `None` when the pose taught nothing.
    pub fn learn(
        &mut self,
        config: &RefineConfig,
        lines: &[Line; 3],
        bend: &Vector2<f64>,
        slack_mm: &Vector3<f64>,
        bellow_mm: &Vector3<f64>,
    ) -> Option<[Line; 3]> {
        let new = self.last_pose.is_none_or(|p| (bend - p).norm() >= config.pose_step_deg.to_radians());
        if !config.enabled || !new {
            return None;
        }
        self.last_pose = Some(*bend);
        let mut next = *lines;
        for i in 0..3 {
            if bellow_mm[i].abs() >= config.strain_min_mm && self.channels[i].add(config, slack_mm[i], bellow_mm[i]) {
                self.raw[i] = self.channels[i].gain(config);
                let step = config.step_max * (1.0 + lines[i].k_epsilon);
                next[i].k_epsilon += (self.raw[i] - lines[i].k_epsilon).clamp(-step, step);
            }
        }
        self.poses += 1;
        Some(next)
    }

    /// Standard deviation of each estimate.
    #[must_use]
    pub fn sigma(&self) -> [f64; 3] {
        self.channels.map(|c| (c.spread / c.information).sqrt())
    }
}

impl Channel {
    fn add(&mut self, config: &RefineConfig, w_mm: f64, q_mm: f64) -> bool {
        let error = (w_mm - q_mm) - self.gain(config) * q_mm;
        // how uncertain the prediction itself still is belongs to the bar
        let doubt = self.spread * (1.0 + q_mm * q_mm / self.information);
        let learn = error * error <= config.outlier * config.outlier * doubt;
        // the spread follows even what is not learned, so that a real change is believed in the end
        self.spread += 0.1 * (error * error - self.spread).min(10.0 * self.spread);
        self.spread = self.spread.max(1e-4);
        if learn {
            let worth = config.prior_poses * FULL_STRAIN_MM * FULL_STRAIN_MM;
            let keep = |now: f64, prior: f64| prior + (now - prior) * config.forgetting;
            self.information = keep(self.information, worth) + q_mm * q_mm;
            self.moment = keep(self.moment, worth * self.prior) + q_mm * (w_mm - q_mm);
        }
        learn
    }

    fn gain(&self, config: &RefineConfig) -> f64 {
        let range = config.range * (1.0 + self.prior);
        (self.moment / self.information).clamp((self.prior - range).max(0.0), self.prior + range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: [f64; 3] = [2.22, 2.53, 2.21];

    fn poses(n: usize) -> impl Iterator<Item = (Vector2<f64>, Vector3<f64>, Vector3<f64>)> {
        (0..n).map(|i| {
            let (beta, delta) = (0.26 * (1 + i % 5) as f64, (i / 5) as f64 * std::f64::consts::FRAC_PI_6);
            let bend = Vector2::new(beta * delta.cos(), beta * delta.sin());
            let q = Vector3::from_fn(|c, _| -4.04 * beta * (delta + c as f64 * 2.094).cos());
            (bend, Vector3::from_fn(|c, _| q[c] * (1.0 + TRUTH[c])), q)
        })
    }

    fn lines(scale: f64) -> [Line; 3] {
        TRUTH.map(|k| Line { k_epsilon: k * scale, k_lambda_mm: 0.9 })
    }

    #[test]
    fn thirty_percent_off_comes_within_five() {
        for scale in [0.7, 1.3] {
            let config = RefineConfig::default();
            let mut now = lines(scale);
            let mut state = RefineState::new(&config, &now);
            for (bend, w, q) in poses(60) {
                if let Some(next) = state.learn(&config, &now, &bend, &w, &q) {
                    now = next;
                }
            }
            for i in 0..3 {
                assert!((now[i].k_epsilon / TRUTH[i] - 1.0).abs() < 0.05, "{scale} {now:?}");
            }
        }
    }

    #[test]
    fn holding_teaches_once() {
        let config = RefineConfig::default();
        let now = lines(1.0);
        let mut state = RefineState::new(&config, &now);
        let Some((bend, w, q)) = poses(3).last() else { panic!("three poses") };
        assert!(state.learn(&config, &now, &bend, &w, &q).is_some());
        let before = state;
        for _ in 0..10_000 {
            assert!(state.learn(&config, &now, &bend, &(w * 1.2), &q).is_none());
        }
        assert_eq!(state, before);
    }

    #[test]
    fn stays_within_its_range_and_finite_for_ever() {
        let config = RefineConfig::default();
        let mut now = lines(1.0);
        let mut state = RefineState::new(&config, &now);
        for round in 0..200 {
            for (bend, w, q) in poses(60) {
                if let Some(next) = state.learn(&config, &now, &bend, &(w * 4.0), &q) {
                    now = next;
                }
            }
            for (i, line) in now.iter().enumerate() {
                assert!(line.k_epsilon <= TRUTH[i] + 0.5 * (1.0 + TRUTH[i]) + 1e-9, "round {round}");
            }
            assert!(state.sigma().iter().all(|s| s.is_finite()));
        }
    }

    #[test]
    fn one_wild_pose_is_not_learned_from() {
        let config = RefineConfig::default();
        let mut now = lines(1.0);
        let mut state = RefineState::new(&config, &now);
        for (bend, w, q) in poses(60) {
            now = state.learn(&config, &now, &bend, &w, &q).unwrap_or(now);
        }
        let before = now[0].k_epsilon;
        let Some((_, w, q)) = poses(4).last() else { panic!("four poses") };
        now = state.learn(&config, &now, &Vector2::new(-1.0, 0.0), &(w * 2.0), &q).unwrap_or(now);
        assert!((now[0].k_epsilon - before).abs() < 1e-3);
    }
}
