//! Online refinement of the transmission gains by recursive least squares.
//!
//! A held pose gives each channel one row of Eq. 22 with one more unknown, `q̃ − q = q k_ε + s k_λ + c`. Here `s` is the side of
//! the backlash, and `c` an offset that drift, lost steps or a play that started off centre leave; without `c` it would be
//! taken for a gain. A piston that has not certainly crossed its backlash gives the row `w − q = q k_ε + c` of its play output
//! `w` instead. Per channel the recursion keeps the information matrix of (k_ε, k_λ, c). The safeguards, in order:
//!
//! 1. **Coverage.** A pose counts only if the tip has moved by `pose_step_deg` since the last one. Holding a pose adds nothing.
//! 2. **Directional forgetting.** Only what a new row measures again is forgotten (Cao & Schwartz 2000): old rows keep
//!    determining what the present poses do not excite, and the estimate neither drifts nor bursts.
//! 3. **Noise.** The variance of a row follows the residuals, so gains of a tip that the model describes badly move less. A row
//!    further than `outlier` standard deviations off is not learned from.
//! 4. **Bounds.** k_ε stays within `±range (1 + k_ε)` of the calibration and k_λ within ±[`LAMBDA_RANGE_MM`], and neither moves
//!    further than `step_max` per pose; the caller compensates the difference in its integrator.

use crate::control::learning::batch::Prior;
use crate::model::Line;
use crate::parameters;
use nalgebra::{Matrix3, Vector2, Vector3};

parameters! {
    /// Online refinement of the transmission gains: learning rate and guards.
    pub struct RefineConfig: Copy {
        /// Learns k_ε and k_λ during operation.
        enabled: bool = true;
        /// Fraction of the information about what a row measures that is kept per row. A larger value remembers longer and
        /// follows a changing tip later.
        forgetting: f64 = 0.99, "", 0.5..=1.0, "0.99 remembers about a hundred poses";
        /// Factor on the standard deviations that the calibration states. A larger value trusts the calibration less.
        prior: f64 = 1.0, "", 0.1..=100.0, "2 allows for a tip that has changed since";
        /// Standard deviation of the offset c. A larger value attributes more of a deviation to drift than to the gains.
        offset_sigma_mm: f64 = 0.03, "mm", 0.001..=5.0, "0.03 is one microstep";
        /// Change of bend between two poses that count. A larger value learns from fewer, more different poses.
        pose_step_deg: f64 = 5.0, "deg", 0.5..=90.0, "5 is well above the noise";
        /// Range of k_ε around the calibration, as a fraction of 1 + k_ε. A larger value follows a worn tip further, and a fault
        /// as well.
        range: f64 = 0.5, "", 0.01..=2.0, "0.5 allows half of 1 + k_ε either way";
        /// Largest change per pose: of k_ε as a fraction of 1 + k_ε, of k_λ in mm. A larger value learns faster and jumps further
        /// on a bad pose.
        step_max: f64 = 0.1, "", 0.001..=1.0, "0.1 crosses the spread between units in three poses";
        /// A row further from the estimate than this many standard deviations is not learned from. A larger value accepts
        /// less plausible poses.
        outlier: f64 = 4.0, "", 1.0..=100.0, "4 rejects what noise does not explain";
    }
}

impl RefineConfig {
    /// Least and largest k_ε, and k_λ in mm, of a channel with this calibration.
    pub fn bounds(&self, prior: &Line) -> [[f64; 2]; 2] {
        let around = |x: f64, range: f64| [(x - range).max(0.0), x + range];
        [
            around(prior.k_epsilon, self.range * (1.0 + prior.k_epsilon)),
            around(prior.k_lambda_mm, LAMBDA_RANGE_MM),
        ]
    }
}

/// Largest distance of k_λ from the calibration, mm.
pub const LAMBDA_RANGE_MM: f64 = 0.8;
/// Initial standard deviation of a row, mm of piston, and the smallest.
const ROW_SIGMA_MM: f64 = 0.3;
const ROW_SIGMA_MIN_MM: f64 = 0.05;
/// Weight of a new residual in the variance of a row.
const SPREAD_GAIN: f64 = 0.1;

/// Recursion of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    prior: Line,
    /// Information about (k_ε, k_λ in mm, c in mm).
    information: Matrix3<f64>,
    estimate: Vector3<f64>,
    /// Running mean square of the residual, mm².
    spread: f64,
}

/// One row: bellow length change, side of the backlash or 0, piston or play output minus bellow; lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    q_mm: f64,
    side: f64,
    excess_mm: f64,
}

/// A held pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldPose {
    /// Estimated bend vector, rad.
    pub bend: Vector2<f64>,
    /// Counted piston positions q̃, mm.
    pub piston_mm: Vector3<f64>,
    /// Outputs of the play operators at the counted steps, mm.
    pub play_output_mm: Vector3<f64>,
    /// Bellow length changes q at the estimated bend, mm.
    pub bellow_mm: Vector3<f64>,
    /// Side of the backlash, −1 or 1, per channel.
    pub side: Vector3<f64>,
    /// 1 for a channel whose piston has certainly crossed its backlash, else 0.
    pub weight: Vector3<f64>,
}

/// State of the learner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefineState {
    channels: [Channel; 3],
    last_pose: Option<Vector2<f64>>,
    /// Number of accepted poses.
    pub poses: u32,
}

impl RefineState {
    /// A learner that starts at the calibrated gains.
    pub fn new(config: &RefineConfig, prior: &[Prior; 3]) -> Self {
        let channels = prior.map(|p| {
            let sigma = Vector3::new(
                config.prior * p.k_epsilon_sigma,
                config.prior * p.k_lambda_sigma_mm,
                config.offset_sigma_mm,
            );
            Channel {
                prior: p.line,
                information: Matrix3::from_diagonal(&sigma.map(|s| 1.0 / (s * s))),
                estimate: Vector3::new(p.line.k_epsilon, p.line.k_lambda_mm, 0.0),
                spread: ROW_SIGMA_MM * ROW_SIGMA_MM,
            }
        });
        Self {
            channels,
            last_pose: None,
            poses: 0,
        }
    }

    /// Learns from a held pose. Returns the new gains, or `None` if the pose was not accepted.
    pub fn learn(
        &mut self,
        config: &RefineConfig,
        lines: &[Line; 3],
        pose: &HeldPose,
    ) -> Option<[Line; 3]> {
        let new = self
            .last_pose
            .is_none_or(|p| (pose.bend - p).norm() >= config.pose_step_deg.to_radians());
        if !config.enabled || !new {
            return None;
        }
        self.last_pose = Some(pose.bend);
        let mut next = *lines;
        for i in 0..3 {
            // a pose that feedback reached by a small reversal counts through its play output. Without such poses only those
            // that needed more push would count, and the gains would grow
            let q_mm = pose.bellow_mm[i];
            let (side, at_mm) = if pose.weight[i] > 0.0 {
                (pose.side[i], pose.piston_mm[i])
            } else {
                (0.0, pose.play_output_mm[i])
            };
            self.channels[i].add(
                config,
                &Row {
                    q_mm,
                    side,
                    excess_mm: at_mm - q_mm,
                },
            );
            next[i] = self.channels[i].towards(config, &lines[i]);
        }
        self.poses += 1;
        Some(next)
    }

    /// Standard deviations of k_ε and of k_λ in mm, per channel, from the scatter of the rows.
    pub fn sigma(&self) -> [[f64; 2]; 3] {
        self.channels.map(|c| {
            let covariance = c.information.try_inverse().unwrap_or_else(Matrix3::zeros);
            [
                covariance[(0, 0)].max(0.0).sqrt(),
                covariance[(1, 1)].max(0.0).sqrt(),
            ]
        })
    }
}

impl Channel {
    fn add(&mut self, config: &RefineConfig, row: &Row) {
        let h = Vector3::new(row.q_mm, row.side, 1.0);
        let error = row.excess_mm - h.dot(&self.estimate);
        let Some(covariance) = self.information.try_inverse() else {
            return;
        };
        // the bound includes the uncertainty of the prediction
        let expected = h.dot(&(covariance * h));
        let learn = error * error <= config.outlier * config.outlier * (self.spread + expected);
        if learn {
            let measured = self.information * h;
            let about = h.dot(&measured);
            if about > 0.0 {
                self.information -=
                    measured * measured.transpose() * ((1.0 - config.forgetting) / about);
            }
            self.information += h * h.transpose() / self.spread;
            if let Some(covariance) = self.information.try_inverse() {
                self.estimate += covariance * h * (error / self.spread);
            }
        }
        // what the estimate leaves; outliers count too, so that a lasting change is accepted eventually
        let left = (error * error - expected).max(0.0).min(10.0 * self.spread);
        self.spread = (self.spread + SPREAD_GAIN * (left - self.spread))
            .max(ROW_SIGMA_MIN_MM * ROW_SIGMA_MIN_MM);
    }

    /// The gains after a step from `line` towards the estimate, within the bounds.
    fn towards(&self, config: &RefineConfig, line: &Line) -> Line {
        let [[k_least, k_most], [lambda_least, lambda_most]] = config.bounds(&self.prior);
        let k_epsilon = self.estimate.x.clamp(k_least, k_most);
        let k_lambda_mm = self.estimate.y.clamp(lambda_least, lambda_most);
        let step = config.step_max * (1.0 + line.k_epsilon);
        Line {
            k_epsilon: line.k_epsilon + (k_epsilon - line.k_epsilon).clamp(-step, step),
            k_lambda_mm: line.k_lambda_mm
                + (k_lambda_mm - line.k_lambda_mm).clamp(-config.step_max, config.step_max),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: [Line; 3] = [
        Line {
            k_epsilon: 2.22,
            k_lambda_mm: 0.9,
        },
        Line {
            k_epsilon: 2.53,
            k_lambda_mm: 0.7,
        },
        Line {
            k_epsilon: 2.21,
            k_lambda_mm: 1.1,
        },
    ];

    /// Poses out and back in twelve directions; the pistons have an offset that is no gain.
    fn poses(n: usize) -> impl Iterator<Item = HeldPose> {
        let mut before = Vector3::<f64>::zeros();
        (0..n).map(move |i| {
            let at = if i % 10 < 5 { 1 + i % 5 } else { 5 - i % 5 };
            let (beta, delta) = (
                0.26 * at as f64,
                (i / 10) as f64 * std::f64::consts::FRAC_PI_6,
            );
            let bend = Vector2::new(beta * delta.cos(), beta * delta.sin());
            let bellow_mm =
                Vector3::from_fn(|c, _| -4.04 * beta * (delta + c as f64 * 2.094).cos());
            let side = (bellow_mm - before).map(f64::signum);
            before = bellow_mm;
            let piston_mm = Vector3::from_fn(|c, _| {
                bellow_mm[c] * (1.0 + TRUTH[c].k_epsilon) + side[c] * TRUTH[c].k_lambda_mm + 0.2
            });
            HeldPose {
                bend,
                piston_mm,
                play_output_mm: piston_mm,
                bellow_mm,
                side,
                weight: Vector3::repeat(1.0),
            }
        })
    }

    fn unknown(line: Line) -> Prior {
        Prior {
            line,
            k_epsilon_sigma: 0.5,
            k_lambda_sigma_mm: 0.24,
        }
    }

    fn start(scale: f64) -> [Line; 3] {
        TRUTH.map(|l| Line {
            k_epsilon: l.k_epsilon * scale,
            k_lambda_mm: 0.9,
        })
    }

    #[test]
    fn gains_30_percent_off_converge_in_40_poses_in_spite_of_an_offset() {
        for scale in [0.7, 1.3] {
            let config = RefineConfig {
                offset_sigma_mm: 0.3,
                ..RefineConfig::default()
            };
            let mut now = start(scale);
            let mut state = RefineState::new(&config, &now.map(unknown));
            for pose in poses(40) {
                now = state.learn(&config, &now, &pose).unwrap_or(now);
            }
            for (found, truth) in now.iter().zip(TRUTH) {
                assert!(
                    (found.k_epsilon / truth.k_epsilon - 1.0).abs() < 0.03,
                    "{scale} {now:?}"
                );
                assert!(
                    (found.k_lambda_mm - truth.k_lambda_mm).abs() < 0.05,
                    "{scale} {now:?}"
                );
            }
            for (i, [k_epsilon, k_lambda_mm]) in state.sigma().into_iter().enumerate() {
                assert!(
                    (now[i].k_epsilon - TRUTH[i].k_epsilon).abs() < 3.0 * k_epsilon,
                    "{scale} {now:?} {k_epsilon}"
                );
                assert!(
                    (now[i].k_lambda_mm - TRUTH[i].k_lambda_mm).abs() < 3.0 * k_lambda_mm,
                    "{scale} {now:?} {k_lambda_mm}"
                );
            }
        }
    }

    #[test]
    fn a_held_pose_counts_once() {
        let config = RefineConfig::default();
        let now = start(1.0);
        let mut state = RefineState::new(&config, &now.map(unknown));
        let Some(pose) = poses(3).last() else {
            panic!("three poses")
        };
        assert!(state.learn(&config, &now, &pose).is_some());
        let before = state;
        for _ in 0..10_000 {
            assert!(
                state
                    .learn(
                        &config,
                        &now,
                        &HeldPose {
                            piston_mm: pose.piston_mm * 1.2,
                            ..pose
                        }
                    )
                    .is_none()
            );
        }
        assert_eq!(state, before);
    }

    #[test]
    fn gains_stay_within_their_range_and_finite() {
        let config = RefineConfig::default();
        let mut now = start(1.0);
        let mut state = RefineState::new(&config, &now.map(unknown));
        for round in 0..200 {
            for pose in poses(60) {
                let pose = HeldPose {
                    piston_mm: pose.piston_mm * 4.0,
                    ..pose
                };
                now = state.learn(&config, &now, &pose).unwrap_or(now);
            }
            for (line, truth) in now.iter().zip(TRUTH) {
                assert!(
                    line.k_epsilon <= truth.k_epsilon + 0.5 * (1.0 + truth.k_epsilon) + 1e-9,
                    "round {round}"
                );
                assert!(
                    (0.0..=0.9 + LAMBDA_RANGE_MM + 1e-9).contains(&line.k_lambda_mm),
                    "round {round}"
                );
            }
            assert!(
                state
                    .sigma()
                    .iter()
                    .flatten()
                    .all(|s| s.is_finite() && *s > 0.0)
            );
        }
    }

    #[test]
    fn an_outlier_is_not_learned_from() {
        let config = RefineConfig::default();
        let mut now = start(1.0);
        let mut state = RefineState::new(&config, &now.map(unknown));
        for pose in poses(60) {
            now = state.learn(&config, &now, &pose).unwrap_or(now);
        }
        let before = now[0];
        let Some(pose) = poses(4).last() else {
            panic!("four poses")
        };
        let outlier = HeldPose {
            bend: Vector2::new(-1.0, 0.0),
            piston_mm: pose.piston_mm * 2.0,
            ..pose
        };
        now = state.learn(&config, &now, &outlier).unwrap_or(now);
        assert!((now[0].k_epsilon - before.k_epsilon).abs() < 1e-3);
    }
}
