//! One arm of the experiment: held states on a fresh world, scored against the true orientation.
//!
//! The true bend is that of the estimator, [`Bend::nearest`]: where the tip has twisted, half of the twist is in its
//! direction. The bend angle β is the same in every definition.

use crate::control::SETTLED_DEG;
use crate::control::learning::schedule::{HOLD_S, Pose, SCORED_S};
use crate::experiment::error::ExperimentError;
use crate::experiment::rig::Rig;
use crate::model::{Bend, Line, Shape};
use crate::primitives::{Base, Rotation, Tip};
use serde::Serialize;

/// Result of one held state.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
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
    /// Mean square of the part of it that the twist of the tip alone causes, degrees².
    pub orientation_floor_sq: f64,
    /// Mean square of the difference between estimated and true bend vector, degrees².
    pub estimate_error_sq: f64,
    /// Time until the bend error stays within 1°, s; `None` if it exceeds 1° within the scored part.
    pub settle_s: Option<f64>,
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
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ArmResult {
    /// Arm name.
    pub name: String,
    /// RMSE of the bend angle, degrees.
    pub bend_rmse_deg: f64,
    /// RMSE of the tip orientation, degrees.
    pub orientation_rmse_deg: f64,
    /// The least orientation RMSE that any controller of the bend can reach, degrees: the twist is not actuated.
    pub orientation_floor_deg: f64,
    /// RMSE of the estimated bend vector, degrees.
    pub estimate_rmse_deg: f64,
    /// Median settling time to 1° over all states, s. A state that does not settle counts as the slowest; if it is the
    /// median, the value is the duration of the hold, a lower bound.
    pub settle_s_median: f64,
    /// 95th percentile of the settling time, s, as the median.
    pub settle_s_p95: f64,
    /// Number of states that do not settle within the hold.
    pub unsettled: usize,
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
    /// k_λ in use at the end, mm.
    pub k_lambda_end_mm: [f64; 3],
    /// Standard deviations of k_ε and of k_λ in mm at the end, per channel.
    pub sigma_end: [[f64; 2]; 3],
    /// The held states.
    pub held: Vec<Held>,
}

/// Runs an arm; `progress` is called after every scored state.
///
/// # Errors
/// [`ExperimentError`] from the world or the alignment, or if there is no reference.
pub fn run(
    name: &str,
    rig: &mut Rig<'_>,
    poses: &[Pose],
    progress: &mut dyn FnMut(),
) -> Result<ArmResult, ExperimentError> {
    rig.align()?;
    let mut held = Vec::with_capacity(poses.len());
    for pose in poses {
        let state = hold(rig, pose)?;
        if pose.scored {
            held.push(state);
            progress();
        }
    }
    Ok(summary(
        name,
        held,
        rig.state.lines(),
        rig.state.line_sigmas(),
    ))
}

impl Held {
    /// Adds a scored sample to the sums.
    fn add(
        &mut self,
        want: &Bend,
        truth: &Rotation<Base, Tip>,
        error_deg: f64,
        estimate: Option<Bend>,
    ) {
        self.bend_error_deg += error_deg;
        self.bend_error_sq += error_deg * error_deg;
        self.orientation_error_sq += want.rotation().angle_to(truth).to_degrees().powi(2);
        self.orientation_floor_sq += floor(want, truth).to_degrees().powi(2);
        self.estimate_error_sq += estimate.map_or(0.0, |b| {
            (b.0 - Bend::nearest(truth).0).norm().to_degrees().powi(2)
        });
    }
}

/// Smallest angle between the rotation of `want` and that of any bend with the twist of `truth`, rad.
///
/// A bend with twist ψ is the quaternion of the bend (β, axis in the plate) times that about z by ψ. Its largest scalar
/// product with that of `want` (β*, no twist) over all bends is √(1 − cos²(β*/2) sin²(ψ/2)).
fn floor(want: &Bend, truth: &Rotation<Base, Tip>) -> f64 {
    let q = truth.quat();
    let half_twist = q.k.atan2(q.w);
    2.0 * ((want.beta() / 2.0).cos() * half_twist.sin()).abs().asin()
}

fn hold(rig: &mut Rig<'_>, pose: &Pose) -> Result<Held, ExperimentError> {
    let dt_s = rig.period_s();
    let ticks = (HOLD_S / dt_s).round() as usize;
    let scored_from = ticks - (SCORED_S / dt_s).round() as usize;
    let want = pose.bend();
    let mut command = Some(Shape::new(want.0, rig.config.geometry.rest_length_mm));
    let mut held = Held {
        bend_deg: pose.bend_deg,
        dir_deg: pose.dir_deg,
        outward: pose.outward,
        ..Held::default()
    };
    let (mut settled_since, mut low, mut high) = (0, f64::INFINITY, f64::NEG_INFINITY);
    for k in 0..ticks {
        let (frame, reply) = rig.advance(command.take())?;
        let truth = reply.truth.ok_or(ExperimentError::NoReference)?;
        let error_deg = pose.bend_deg - Bend::nearest(&truth).beta().to_degrees();
        held.blocked |= frame.blocked;
        held.base_moved |= frame.base_moved || frame.base_doubted;
        held.stopped |= frame.senses.held;
        (held.lag_s, held.delay_s) = (frame.dynamics.lag_s, frame.dynamics.delay_s);
        held.feedback_deg = frame.feedback.norm().to_degrees();
        if error_deg.abs() > SETTLED_DEG {
            settled_since = k + 1;
        }
        if k >= scored_from {
            held.add(&want, &truth, error_deg, frame.estimate.map(|e| e.bend));
            (low, high) = (low.min(error_deg), high.max(error_deg));
        }
    }
    let scored = (ticks - scored_from).max(1) as f64;
    held.bend_error_deg /= scored;
    held.bend_error_sq /= scored;
    held.orientation_error_sq /= scored;
    held.orientation_floor_sq /= scored;
    held.estimate_error_sq /= scored;
    held.peak_to_peak_deg = (high - low).max(0.0);
    held.settle_s = (settled_since <= scored_from).then_some(settled_since as f64 * dt_s);
    Ok(held)
}

/// The root of the mean; 0 if there are no values.
pub fn root_mean(squares: impl IntoIterator<Item = f64>) -> f64 {
    let (mut n, mut sum) = (0.0, 0.0);
    for x in squares {
        (n, sum) = (n + 1.0, sum + x);
    }
    (sum / f64::max(n, 1.0)).sqrt()
}

/// The value below which a share of the values lies; 0 if there are none.
pub fn percentile(values: impl IntoIterator<Item = f64>, share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    let at = (share * sorted.len() as f64) as usize;
    sorted.get(at).or(sorted.last()).copied().unwrap_or(0.0)
}

fn summary(name: &str, held: Vec<Held>, lines: &[Line; 3], sigma_end: [[f64; 2]; 3]) -> ArmResult {
    let rms = |f: fn(&Held) -> f64| root_mean(held.iter().map(f));
    let settle = |share: f64| percentile(held.iter().map(|h| h.settle_s.unwrap_or(HOLD_S)), share);
    let count = |f: fn(&Held) -> bool| held.iter().filter(|h| f(h)).count();
    ArmResult {
        name: name.to_owned(),
        bend_rmse_deg: rms(|h| h.bend_error_sq),
        orientation_rmse_deg: rms(|h| h.orientation_error_sq),
        orientation_floor_deg: rms(|h| h.orientation_floor_sq),
        estimate_rmse_deg: rms(|h| h.estimate_error_sq),
        settle_s_median: settle(0.5),
        settle_s_p95: settle(0.95),
        unsettled: count(|h| h.settle_s.is_none()),
        peak_to_peak_max_deg: held.iter().map(|h| h.peak_to_peak_deg).fold(0.0, f64::max),
        states: held.len(),
        blocked: count(|h| h.blocked),
        base_moved: count(|h| h.base_moved),
        stopped: count(|h| h.stopped),
        k_eps_end: lines.map(|l| l.k_epsilon),
        k_lambda_end_mm: lines.map(|l| l.k_lambda_mm),
        sigma_end,
        held,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Rad;
    use nalgebra::{UnitQuaternion, Vector3};

    const LINES: [Line; 3] = [Line {
        k_epsilon: 2.2,
        k_lambda_mm: 0.9,
    }; 3];

    fn twisted(bend: Bend, twist: f64) -> Rotation<Base, Tip> {
        Rotation::assert_frames(
            bend.rotation().quat() * UnitQuaternion::from_scaled_axis(Vector3::z() * twist),
        )
    }

    #[test]
    fn no_bend_with_the_same_twist_is_nearer_than_the_floor() {
        for (beta, twist) in [(75.0, 0.2), (15.0, -0.1), (45.0, 0.0), (0.0, 0.3)] {
            let want = Bend::from_deg(beta, 40.0);
            let floor = floor(&want, &twisted(want, twist));
            let other =
                |db: f64, dd: f64| Bend::from_polar(Rad(want.beta() + db), Rad(want.delta() + dd));
            let angle = |db: f64, dd: f64| want.rotation().angle_to(&twisted(other(db, dd), twist));
            let steps = || (-80..=80).map(|k| f64::from(k) * 2.5e-3);
            let best = steps()
                .flat_map(|db| steps().map(move |dd| (db, dd)))
                .map(|(b, d)| angle(b, d))
                .fold(f64::INFINITY, f64::min);
            assert!(
                best >= floor - 1e-9 && best < floor + 2e-3,
                "{beta}° {twist}: {best} {floor}"
            );
        }
    }

    #[test]
    fn a_state_that_does_not_settle_is_the_slowest_and_is_counted() {
        let state = |settle_s| Held {
            settle_s,
            ..Held::default()
        };
        let of = |times: &[Option<f64>]| {
            let held = times.iter().map(|&t| state(t)).collect();
            summary("closed", held, &LINES, [[0.0; 2]; 3])
        };
        let r = of(&[Some(0.2), Some(0.4), Some(0.3), None]);
        assert_eq!(
            (r.settle_s_median, r.settle_s_p95, r.unsettled),
            (0.4, HOLD_S, 1)
        );
        let r = of(&[Some(0.2), None, None]);
        assert_eq!((r.settle_s_median, r.unsettled), (HOLD_S, 2));
    }
}
