//! The nominal model run forward from the pistons, with any set of effects in it.
//!
//! pistons → play → 1/(1 + k_ε) → first-order lag τ₀ → constant curvature → tip orientation. Each effect changes the
//! signal at its own stage. The lag integrates a straight line between two instants exactly, so a step may be longer
//! than τ₀. [`mod@crate::diagnosis::tip::model::sense`] turns the motion into readings.

use crate::diagnosis::tip::observed::{Observed, Row, Segment, piston_after};
use crate::model::effects::{Memory, Pose};
use crate::model::{Bend, Chain, Model};
use nalgebra::{Matrix3, Vector3};
use std::borrow::Cow;

/// Largest mechanical lag that counts as nominal, s.
pub const LAG_MAX_S: f64 = 0.05;
/// Time step assumed at the first instant, s.
pub const FIRST_STEP_S: f64 = 0.01;

/// Tip in the base frame, instant by instant; zero at instants that no sensor samples.
pub type Motion = Vec<Matrix3<f64>>;

/// Parameters as a segment has them: the times of its own events count from its start, and other segments' events are absent.
pub fn parameters<'p>(
    log: &Observed,
    segment: &Segment,
    model: &Model,
    theta: &'p [f64],
) -> Cow<'p, [f64]> {
    if log.segments.len() == 1 {
        return Cow::Borrowed(theta);
    }
    let mut own = theta.to_vec();
    for event in model.all_events() {
        let at_s = log.start_s() + theta[event.time];
        let of = log.segments.iter().rev().find(|s| s.start_s <= at_s);
        if of.unwrap_or(&log.segments[0]) == segment {
            own[event.time] = at_s - segment.start_s;
        } else {
            event.offsets.iter().for_each(|&o| own[o] = 0.0);
        }
    }
    Cow::Owned(own)
}

/// Runs the model through the whole log.
pub fn run(log: &Observed, model: &Model, theta: &[f64]) -> Motion {
    let mut out = Vec::with_capacity(log.instants.len());
    for segment in &log.segments {
        let own = parameters(log, segment, model, theta);
        append(log, segment, model, &own, &mut out);
        // the initial rest *defines* zero bend and the base frame, also for a tip that sags before anything moves
        let motion = &mut out[segment.instants.clone()];
        let back = motion.first().map(Matrix3::transpose);
        if let Some(back) = back.filter(|back| *back != Matrix3::identity()) {
            motion.iter_mut().for_each(|r| *r = back * *r);
        }
    }
    out
}

/// Appends the motion of one segment, which starts at rest.
fn append(log: &Observed, segment: &Segment, model: &Model, theta: &[f64], out: &mut Motion) {
    let lag_s = theta[6].max(1e-3);
    let behind_s: f64 = model.each(theta).map(|(e, p)| e.transport_s(p)).sum();
    // a late sensor also samples between the middles of bins
    let every = model.each(theta).any(|(e, p)| e.latency_s(p) > 0.0);
    let chain = Chain::new(log.rig.geometry, model, theta);
    let mut memory = vec![Memory::default(); model.effects.len()];
    let mut at = chain.moment(segment.rest.up, FIRST_STEP_S);
    // the pistons as counted a dead time ago; called with increasing instants
    let mut row = segment.rows.start;
    let mut counted_mm = |now: &Row| {
        if behind_s <= 0.0 {
            return now.piston_mm;
        }
        let t_s = now.t_s - behind_s;
        while log.rows.get(row + 1).is_some_and(|next| next.t_s <= t_s) {
            row += 1;
        }
        piston_after(&log.rows, row, t_s)
    };
    let (mut w, mut lagged, mut before) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
    let (mut keep, mut keep_dt) = (0.0, -1.0);
    let mut middles = log.bins[segment.bins.clone()].iter().peekable();
    let mut last_s = None;
    for k in segment.instants.clone() {
        let now = &log.instants[k];
        let dt_s = last_s
            .replace(now.t_s)
            .map_or(FIRST_STEP_S, |last_s: f64| now.t_s - last_s);
        (at.t_s, at.dt_s) = (now.t_s - segment.start_s, dt_s);
        (at.counted_mm, at.idle_s) = (counted_mm(now), now.idle_s);
        if (dt_s - keep_dt).abs() > 1e-7 {
            (keep, keep_dt) = ((-dt_s / lag_s).exp(), dt_s);
        }
        w = chain.play(&w, &chain.pistons(&mut memory, &at, &at.counted_mm));
        let q = chain.bellows(&mut memory, &at, &w);
        // the response to a ramp trails it by slope · τ₀
        let behind = (q - before) * (lag_s / dt_s);
        lagged = q - behind + (lagged - before + behind) * keep;
        before = q;
        let middle = middles.next_if(|bin| bin.at == k).is_some();
        out.push(if every || middle {
            orientation(&chain.pose(&mut memory, &at, &lagged))
        } else {
            Matrix3::zeros()
        });
    }
}

/// Tip orientation of a pose, tip → base.
fn orientation(pose: &Pose) -> Matrix3<f64> {
    let bent = rotation(&Bend(pose.bend));
    if pose.twist == 0.0 {
        return bent;
    }
    let (s, c) = pose.twist.sin_cos();
    bent * Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

/// Rodrigues' formula for the axis (b_y, b_x, 0): Eq. 7 as a matrix.
fn rotation(bend: &Bend) -> Matrix3<f64> {
    let beta2 = bend.0.norm_squared();
    let beta = beta2.sqrt();
    let (s, v) = if beta < 1e-6 {
        (1.0, 0.5)
    } else {
        (beta.sin() / beta, (1.0 - beta.cos()) / beta2)
    };
    let (x, y) = (bend.0.y, bend.0.x);
    let first = [1.0 - v * y * y, v * x * y, -s * y];
    let second = [v * x * y, 1.0 - v * x * x, s * x];
    Matrix3::from([first, second, [s * y, -s * x, 1.0 - v * beta2]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_equals_the_rotation_of_the_bend_model() {
        for (x, y) in [(0.0, 0.0), (0.5, -0.3), (-1.2, 0.9), (1e-8, 0.0)] {
            let b = Bend(nalgebra::Vector2::new(x, y));
            let want = b.rotation().quat().to_rotation_matrix().into_inner();
            assert!((rotation(&b) - want).norm() < 1e-12);
        }
    }
}
