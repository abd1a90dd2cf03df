//! A path driven in closed loop on a fresh world, scored against the true bend.

use crate::control::Path;
use crate::experiment::arm::{percentile, root_mean};
use crate::experiment::error::ExperimentError;
use crate::experiment::rig::Rig;
use crate::model::Bend;
use nalgebra::Vector2;
use serde::Serialize;

/// Least and greatest time at the first point before the path begins, s.
const SETTLE_S: (f64, f64) = (1.0, 8.0);
/// Delays among which the best is sought, s.
const DELAYS_S: (f64, f64) = (-0.2, 1.0);

/// Result of a path.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct TrackResult {
    /// RMS length of desired minus true bend vector, degrees.
    pub rmse_deg: f64,
    /// 95th percentile of it, degrees.
    pub p95_deg: f64,
    /// Maximum of it, degrees.
    pub max_deg: f64,
    /// Delay of the true against the desired bend that fits best, s.
    pub delay_s: f64,
    /// RMS length of what is left after that delay, degrees.
    pub rmse_delayed_deg: f64,
    /// RMS length of estimated minus true bend vector, degrees.
    pub estimate_rmse_deg: f64,
    /// Duration of the path, s, as it was driven.
    pub duration_s: f64,
    /// Each point became known only at its time.
    pub live: bool,
    /// Factor by which the time of the path would have to be stretched for the pistons to follow; up to 1 they can.
    pub demand: f64,
    /// Factor by which it was stretched. A live path is never stretched.
    pub time_scale: f64,
}

/// Moves to the first point of a path and drives it; `progress` is called every second.
///
/// # Errors
/// [`ExperimentError`] from the world or the alignment, or if there is no reference.
pub fn run(
    rig: &mut Rig<'_>,
    path: &Path,
    live: bool,
    progress: &mut dyn FnMut(),
) -> Result<TrackResult, ExperimentError> {
    let config = &rig.config;
    let demand = path.demand(&config.geometry, &config.lines, &config.motion.limits);
    let time_scale = if live { 1.0 } else { demand.max(1.0) };
    let path = path.slowed(time_scale);
    rig.align()?;
    let mut command = Some(path.at(0.0).shape);
    let (from_s, dt_s) = (rig.now().0, rig.period_s());
    loop {
        let (frame, _) = rig.advance(command.take())?;
        let waited_s = rig.now().0 - from_s;
        if waited_s > SETTLE_S.1 || waited_s > SETTLE_S.0 && frame.at_rest {
            break;
        }
    }
    let begins_after_s = rig.state.begins_after_s(&rig.config);
    let from_s = rig.now().0 + if live { 0.0 } else { begins_after_s };
    let duration_s = path.duration_s();
    let mut samples = Vec::new();
    let mut estimate_sq = Vec::new();
    while samples.len() as f64 * dt_s < duration_s + DELAYS_S.1 {
        let now_s = rig.now().0 - from_s;
        let ahead_s = rig.state.answers_after_s(&rig.config, dt_s);
        rig.reference = Some(if live {
            path.expected(now_s, ahead_s, &rig.config.bend_pace)
        } else {
            path.at(now_s + ahead_s)
        });
        let (frame, reply) = rig.advance(None)?;
        if now_s < -dt_s / 2.0 {
            continue;
        }
        let truth = Bend::nearest(&reply.truth.ok_or(ExperimentError::NoReference)?).0;
        samples.push(truth);
        if now_s < duration_s {
            estimate_sq.extend(frame.estimate.map(|e| (e.bend.0 - truth).norm_squared()));
        }
        if samples.len() % ((1.0 / dt_s) as usize).max(1) == 0 {
            progress();
        }
    }
    Ok(TrackResult {
        estimate_rmse_deg: root_mean(estimate_sq).to_degrees(),
        duration_s,
        live,
        demand,
        time_scale,
        ..score(&path, &samples, dt_s)
    })
}

/// Scores the true bends, of which the first is `dt_s` after the beginning of the path.
fn score(path: &Path, truth: &[Vector2<f64>], dt_s: f64) -> TrackResult {
    let rows = ((path.duration_s() / dt_s + 1e-6) as usize).min(truth.len());
    let bend = |k: usize| path.at(k as f64 * dt_s).shape.bend.0;
    let desired: Vec<_> = (1..=rows).map(bend).collect();
    let errors = |shift: isize| {
        let shifted = move |k: usize| truth.get(k.checked_add_signed(shift)?);
        let error =
            move |(k, want): (usize, &Vector2<f64>)| Some((shifted(k)? - want).norm().to_degrees());
        desired.iter().enumerate().filter_map(error)
    };
    let rmse = |shift: isize| root_mean(errors(shift).map(|e| e * e));
    let ticks = |s: f64| (s / dt_s).round() as isize;
    let best = (ticks(DELAYS_S.0)..ticks(DELAYS_S.1))
        .min_by(|&a, &b| rmse(a).total_cmp(&rmse(b)))
        .unwrap_or(0);
    TrackResult {
        rmse_deg: rmse(0),
        p95_deg: percentile(errors(0), 0.95),
        max_deg: errors(0).fold(0.0, f64::max),
        delay_s: best as f64 * dt_s,
        rmse_delayed_deg: rmse(best),
        ..TrackResult::default()
    }
}
