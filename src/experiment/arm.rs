//! One arm of the experiment: 120 held states on a fresh world, scored against the true orientation.

use crate::control::tick::Command;
use crate::experiment::rig::{Rig, RigError};
use crate::experiment::schedule::{HOLD_S, Pose, SCORED_S};
use crate::model::bend::Bend;
use crate::primitives::units::Mm;
use nalgebra::Vector2;
use serde::Serialize;

/// Result of one held state.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Held {
    /// Desired bend, degrees.
    pub bend_deg: f64,
    /// Desired direction, degrees.
    pub dir_deg: f64,
    /// The previous bend was smaller.
    pub outward: bool,
    /// Mean of desired minus true bend over the scored part, degrees.
    pub bend_error_deg: f64,
    /// Mean square of desired minus true bend, degrees².
    pub bend_error_sq: f64,
    /// Mean square of the angle between desired and true tip orientation, degrees².
    pub orientation_error_sq: f64,
    /// Mean square of the difference between estimated and true bend vector, degrees².
    pub estimate_error_sq: f64,
    /// Time until the bend error stays within 1°, s; the whole hold if it does not.
    pub settle_s: f64,
    /// Peak-to-peak motion of the true bend over the scored part, degrees.
    pub peak_to_peak_deg: f64,
    /// The loop detected an obstruction.
    pub blocked: bool,
    /// The loop detected a motion of the base.
    pub base_moved: bool,
    /// The loop stopped the pistons because of the sensors.
    pub stopped: bool,
    /// Lag in use at the end, s.
    pub lag_s: f64,
    /// Dead time in use at the end, s.
    pub delay_s: f64,
    /// Feedback in the command at the end, degrees.
    pub feedback_deg: f64,
}

/// Result of one arm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ArmResult {
    /// Arm name.
    pub name: String,
    /// RMSE of the bend angle, degrees.
    pub bend_rmse_deg: f64,
    /// RMSE of the tip orientation, degrees.
    pub orientation_rmse_deg: f64,
    /// RMSE of the estimated bend vector, degrees.
    pub estimate_rmse_deg: f64,
    /// Median settling time to 1°, s.
    pub settle_s_median: f64,
    /// Largest motion within a scored part, degrees.
    pub peak_to_peak_max_deg: f64,
    /// Number of held states.
    pub states: usize,
    /// Number of states with a detected obstruction.
    pub blocked: usize,
    /// Number of states with a detected motion of the base.
    pub base_moved: usize,
    /// Number of states in which the sensors stopped the pistons.
    pub stopped: usize,
    /// k_ε in use at the end.
    pub k_eps_end: [f64; 3],
    /// The held states.
    pub held: Vec<Held>,
}

/// Bend error of a settled tip, degrees.
const SETTLED_DEG: f64 = 1.0;

/// Runs an arm; `progress` is called after every state.
///
/// # Errors
/// [`RigError`] from the world or the alignment, or if there is no reference.
pub fn run(name: &str, rig: &mut Rig<'_>, poses: &[Pose], progress: &mut dyn FnMut()) -> Result<ArmResult, RigError> {
    rig.align()?;
    let mut held = Vec::with_capacity(poses.len());
    for pose in poses {
        held.push(hold(rig, pose)?);
        progress();
    }
    Ok(summary(name, held, rig.state.lines().map(|l| l.k_epsilon)))
}

fn hold(rig: &mut Rig<'_>, pose: &Pose) -> Result<Held, RigError> {
    let dt_s = rig.period_s();
    let ticks = (HOLD_S / dt_s).round() as usize;
    let scored_from = ticks - (SCORED_S / dt_s).round() as usize;
    let want = pose.bend().rotation();
    let mut command = Some(Command { bend: pose.bend(), length: Mm(rig.config.geometry.rest_length_mm) });
    let (mut sum, mut sum_sq, mut turn_sq, mut estimate_sq, mut low, mut high) = (0.0, 0.0, 0.0, 0.0, f64::INFINITY, f64::NEG_INFINITY);
    let (mut settled_since, mut last) = (0, None);
    let (mut blocked, mut base_moved, mut stopped) = (false, false, false);
    for k in 0..ticks {
        let (frame, reply) = rig.advance(command.take())?;
        let truth = reply.truth.ok_or(RigError::NoReference)?;
        let true_bend = Bend::from_rotation(&truth);
        let error_deg = pose.bend_deg - true_bend.beta().to_degrees();
        blocked |= frame.blocked;
        base_moved |= frame.base_moved || frame.base_doubted;
        stopped |= frame.senses.held;
        last = Some((frame.dynamics, frame.feedback));
        if error_deg.abs() > SETTLED_DEG {
            settled_since = k + 1;
        }
        if k >= scored_from {
            sum += error_deg;
            sum_sq += error_deg * error_deg;
            turn_sq += want.angle_to(&truth).to_degrees().powi(2);
            estimate_sq += frame.estimate.map_or(0.0, |f| (f.bend.0 - true_bend.0).norm().to_degrees().powi(2));
            (low, high) = (low.min(error_deg), high.max(error_deg));
        }
    }
    let n = (ticks - scored_from) as f64;
    let (dynamics, feedback) = last.unwrap_or((rig.config.dynamics, Vector2::zeros()));
    Ok(Held {
        bend_deg: pose.bend_deg,
        dir_deg: pose.dir_deg,
        outward: pose.outward,
        bend_error_deg: sum / n,
        bend_error_sq: sum_sq / n,
        orientation_error_sq: turn_sq / n,
        estimate_error_sq: estimate_sq / n,
        settle_s: settled_since as f64 * dt_s,
        peak_to_peak_deg: high - low,
        blocked,
        base_moved,
        stopped,
        lag_s: dynamics.lag_s,
        delay_s: dynamics.delay_s,
        feedback_deg: feedback.norm().to_degrees(),
    })
}

fn summary(name: &str, held: Vec<Held>, k_eps_end: [f64; 3]) -> ArmResult {
    let rms = |f: fn(&Held) -> f64| (held.iter().map(f).sum::<f64>() / held.len().max(1) as f64).sqrt();
    let mut settle: Vec<f64> = held.iter().map(|h| h.settle_s).collect();
    settle.sort_by(f64::total_cmp);
    ArmResult {
        name: name.to_owned(),
        bend_rmse_deg: rms(|h| h.bend_error_sq),
        orientation_rmse_deg: rms(|h| h.orientation_error_sq),
        estimate_rmse_deg: rms(|h| h.estimate_error_sq),
        settle_s_median: settle.get(settle.len() / 2).copied().unwrap_or(0.0),
        peak_to_peak_max_deg: held.iter().map(|h| h.peak_to_peak_deg).fold(0.0, f64::max),
        states: held.len(),
        blocked: held.iter().filter(|h| h.blocked).count(),
        base_moved: held.iter().filter(|h| h.base_moved).count(),
        stopped: held.iter().filter(|h| h.stopped).count(),
        k_eps_end,
        held,
    }
}
