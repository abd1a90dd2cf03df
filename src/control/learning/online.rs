//! Online refinement of k_ε by recursive least squares.
//!
//! In a held pose the play output of channel i is `w_i` and its bellow is at `q_i`. Eq. 16 without the backlash, which
//! the play operator has removed, reads `w_i − q_i = k_ε,i q_i`: one scalar recursion per channel with exponential
//! forgetting. The gain of a real tip depends on the direction of its bend, so twelve sectors of direction forget
//! separately; work in one direction cannot move the gain away from what the others require. The safeguards, in order:
//!
//! 1. **Coverage.** A pose counts only if the tip has moved by `pose_step_deg` since the last accepted pose, and a
//!    channel only if its bellow is strained by `strain_min_mm`. Holding a pose adds nothing, so the estimate neither
//!    drifts nor does its covariance grow.
//! 2. **Prior.** The information of the prior is never forgotten; only that of the poses decays.
//! 3. **Bounds.** The gain stays within `±range` of the calibrated prior.
//! 4. **Rate limit.** The gain in use follows the estimate by a bounded step per pose; the caller compensates the
//!    difference in its integrator.
//! 5. **Outliers.** A row that deviates by more than `outlier` times the spread is not learned from.

use crate::model::transmission::Line;
use crate::parameters;
use nalgebra::{Vector2, Vector3};
use std::f64::consts::TAU;

parameters! {
    /// Online refinement of the extension gains: learning rate and guards.
    pub struct RefineConfig: Copy {
        /// Learns k_ε during operation.
        enabled: bool = true;
        /// Fraction of a sector's information that is kept per accepted pose in that sector of bend directions; the default
        /// is a memory of about ten poses a sector, 120 in all. A larger value remembers longer and follows a changing tip
        /// later.
        forgetting: f64 = 0.9, "", 0.5..=1.0, "0.9 remembers about ten poses in each of twelve directions";
        /// Weight of the calibrated prior, in poses of full strain. A larger value holds the gains closer to the
        /// calibration.
        prior_poses: f64 = 1.0, "", 0.01..=1000.0, "1 weighs the calibration as one pose";
        /// Change of bend between two poses that count. A larger value learns from fewer, more different poses.
        pose_step_deg: f64 = 5.0, "deg", 0.5..=90.0, "5 is well above the noise";
        /// Smallest strain of a bellow for its row to count. A larger value ignores gentle bends, in which an offset would
        /// be taken for a gain.
        strain_min_mm: f64 = 1.0, "mm", 0.1..=10.0, "1 is a bend of about 20°";
        /// Range around the prior, as a fraction of 1 + k_ε. A larger value follows a worn tip further, and a fault as well.
        range: f64 = 0.5, "", 0.01..=2.0, "0.5 allows half of 1 + k_ε either way";
        /// Largest change of a gain per pose, as a fraction of 1 + k_ε. A larger value learns faster and jumps further on a
        /// bad pose.
        step_max: f64 = 0.04, "", 0.001..=1.0, "0.04 is not noticed in the motion";
        /// A row further from the estimate than this many standard deviations is not learned from. A larger value accepts
        /// less plausible poses.
        outlier: f64 = 4.0, "", 1.0..=100.0, "4 rejects what noise does not explain";
    }
}

/// Sectors of bend direction: the directions of the paper's experiment.
const SECTORS: usize = 12;

/// Information of one channel in one sector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Information {
    /// Σ λ^n q², mm².
    information: f64,
    /// Σ λ^n q (w − q), mm².
    moment: f64,
}

/// Recursion of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    prior: f64,
    sectors: [Information; SECTORS],
    /// Running mean square of the row error, mm².
    spread: f64,
}

/// State of the learner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefineState {
    channels: [Channel; 3],
    last_pose: Option<Vector2<f64>>,
    /// Number of accepted poses.
    pub poses: u32,
    /// Estimate of each channel before the limit of its rate of change.
    pub raw: [f64; 3],
}

/// Strain of a pose whose weight equals that of one prior pose, mm.
const FULL_STRAIN_MM: f64 = 4.0;

impl RefineState {
    /// A learner that starts at the calibrated gains.
    #[must_use]
    pub fn new(prior: &[Line; 3]) -> Self {
        Self {
            channels: prior.map(|p| Channel { prior: p.k_epsilon, sectors: [Information::default(); SECTORS], spread: 1.0 }),
            last_pose: None,
            poses: 0,
            raw: prior.map(|l| l.k_epsilon),
        }
    }

    /// Learns from a held pose: estimated bend in rad, play outputs and bellow length changes in mm. Returns the new gains,
    /// or `None` if the pose was not accepted.
    pub fn learn(
        &mut self,
        config: &RefineConfig,
        lines: &[Line; 3],
        bend: &Vector2<f64>,
        play_output_mm: &Vector3<f64>,
        bellow_mm: &Vector3<f64>,
    ) -> Option<[Line; 3]> {
        let new = self.last_pose.is_none_or(|p| (bend - p).norm() >= config.pose_step_deg.to_radians());
        if !config.enabled || !new {
            return None;
        }
        self.last_pose = Some(*bend);
        let (sector, mut next) = (sector_of(bend), *lines);
        for i in 0..3 {
            if bellow_mm[i].abs() >= config.strain_min_mm && self.channels[i].add(config, sector, play_output_mm[i], bellow_mm[i]) {
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
    pub fn sigma(&self, config: &RefineConfig) -> [f64; 3] {
        self.channels.map(|c| (c.spread / c.total(config).information).sqrt())
    }
}

/// Sector of a bend.
fn sector_of(bend: &Vector2<f64>) -> usize {
    let turn = bend.y.atan2(bend.x).rem_euclid(TAU) / TAU;
    // the directions of the experiment lie at the centres of the sectors; f64 to usize saturates
    (turn * SECTORS as f64).round() as usize % SECTORS
}

impl Channel {
    fn add(&mut self, config: &RefineConfig, sector: usize, w_mm: f64, q_mm: f64) -> bool {
        let error = (w_mm - q_mm) - self.gain(config) * q_mm;
        // the bound includes the uncertainty of the prediction
        let variance = self.spread * (1.0 + q_mm * q_mm / self.total(config).information);
        let learn = error * error <= config.outlier * config.outlier * variance;
        // the spread follows outliers too, so that a lasting change is accepted eventually
        self.spread += 0.1 * (error * error - self.spread).min(10.0 * self.spread);
        self.spread = self.spread.max(1e-4);
        if learn {
            let here = &mut self.sectors[sector];
            here.information = config.forgetting * here.information + q_mm * q_mm;
            here.moment = config.forgetting * here.moment + q_mm * (w_mm - q_mm);
        }
        learn
    }

    /// Sum over all sectors and the prior.
    fn total(&self, config: &RefineConfig) -> Information {
        let worth = config.prior_poses * FULL_STRAIN_MM * FULL_STRAIN_MM;
        let prior = Information { information: worth, moment: worth * self.prior };
        self.sectors
            .iter()
            .fold(prior, |sum, s| Information { information: sum.information + s.information, moment: sum.moment + s.moment })
    }

    fn gain(&self, config: &RefineConfig) -> f64 {
        let range = config.range * (1.0 + self.prior);
        let Information { information, moment } = self.total(config);
        (moment / information).clamp((self.prior - range).max(0.0), self.prior + range)
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
    fn a_gain_30_percent_off_converges_to_5_percent() {
        for scale in [0.7, 1.3] {
            let config = RefineConfig::default();
            let mut now = lines(scale);
            let mut state = RefineState::new(&now);
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
    fn a_held_pose_counts_once() {
        let config = RefineConfig::default();
        let now = lines(1.0);
        let mut state = RefineState::new(&now);
        let Some((bend, w, q)) = poses(3).last() else { panic!("three poses") };
        assert!(state.learn(&config, &now, &bend, &w, &q).is_some());
        let before = state;
        for _ in 0..10_000 {
            assert!(state.learn(&config, &now, &bend, &(w * 1.2), &q).is_none());
        }
        assert_eq!(state, before);
    }

    #[test]
    fn gains_stay_within_their_range_and_finite() {
        let config = RefineConfig::default();
        let mut now = lines(1.0);
        let mut state = RefineState::new(&now);
        for round in 0..200 {
            for (bend, w, q) in poses(60) {
                if let Some(next) = state.learn(&config, &now, &bend, &(w * 4.0), &q) {
                    now = next;
                }
            }
            for (i, line) in now.iter().enumerate() {
                assert!(line.k_epsilon <= TRUTH[i] + 0.5 * (1.0 + TRUTH[i]) + 1e-9, "round {round}");
            }
            assert!(state.sigma(&config).iter().all(|s| s.is_finite()));
        }
    }

    #[test]
    fn an_outlier_is_not_learned_from() {
        let config = RefineConfig::default();
        let mut now = lines(1.0);
        let mut state = RefineState::new(&now);
        for (bend, w, q) in poses(60) {
            now = state.learn(&config, &now, &bend, &w, &q).unwrap_or(now);
        }
        let before = now[0].k_epsilon;
        let Some((_, w, q)) = poses(4).last() else { panic!("four poses") };
        now = state.learn(&config, &now, &Vector2::new(-1.0, 0.0), &(w * 2.0), &q).unwrap_or(now);
        assert!((now[0].k_epsilon - before).abs() < 1e-3);
    }
}
