//! The observing half of the tick: what the pistons should have caused, beside the estimate.

use super::state::LoopState;
use super::types::LoopConfig;
use crate::control::observer::Measured;
use crate::control::observer::laws::{GAIN, ODD};
use crate::estimation::fusion::tip::TipEstimate;
use crate::model::Line;
use crate::primitives::Steps;
use nalgebra::Matrix2;

/// Time at rest for which a pose teaches the laws, s: what the estimate has wrong there lasts as long as the pose does.
const TEACHES_S: f64 = 3.0;
/// Slope of the straight line that fits a cubic best on [−1, 1]: the mean of x⁴ over the mean of x², (1/5) / (1/3).
const CUBIC: f64 = 3.0 / 5.0;

/// Follows the counted steps.
pub(super) fn follow_steps(config: &LoopConfig, state: &mut LoopState, steps: &Steps, dt_s: f64) {
    let mut piston_mm = config.drive.piston_mm(steps);
    let mut modelled = None;
    if let Some(described) = &mut state.described {
        piston_mm = described.pistons(&piston_mm);
        let play_output_mm = state.observer.play_outputs(&piston_mm);
        modelled = Some(described.advance(&play_output_mm, dt_s).bend.0);
    }
    state.observer.follow(&piston_mm, modelled, dt_s);
    let from = modelled.unwrap_or_else(|| state.observer.played_by(&state.accepted)[1]);
    let keep = (-dt_s / state.observer.dynamics.lag_s.max(1e-3)).exp();
    state.shown_by_accepted = from + (state.shown_by_accepted - from) * keep;
}

/// Learns from the estimate: lag and dead time, a periodic disturbance, and the laws.
pub(super) fn learn(
    config: &LoopConfig,
    state: &mut LoopState,
    estimate: &TipEstimate,
    moving: bool,
    dt_s: f64,
) {
    let Some(f) = &config.feedback else { return };
    let (bend, observer) = (estimate.bend.0, &mut state.observer);
    let disturbance = state.periodic.at(0.0).0;
    let laws = !state.obstruction.blocked && state.rule.held_s < TEACHES_S;
    if f.learn_dynamics && laws && state.bank.step(observer.modelled, bend - disturbance, dt_s) {
        state.dynamics = state.bank.assess(&state.before, &state.dynamics);
        observer.take_dynamics(&state.dynamics, moving);
    }
    state.unexplained += bend - state.last_estimate - observer.rate() * dt_s;
    // a path has periods of its own
    if state.setpoint.acceleration.is_none() {
        let least = f.observer.noise_deg.to_radians().powi(2);
        let (noise, moved) = (observer.variance.max(least), observer.rate().norm() * dt_s);
        let (periodic, unexplained) = (&mut state.periodic, &state.unexplained);
        // what holds the tip back is no disturbance, nor is what comes free on the way to the next pose
        if state.obstruction.blocked || moving && periodic.is_new() {
            periodic.restart(&f.periodic, unexplained);
        } else {
            periodic.step(&f.periodic, unexplained, 2.0 * noise, moved, dt_s);
        }
    }
    let sway_2 = state.before_base.sway_rad.powi(2);
    let measured = Measured {
        bend: bend - state.periodic.at(0.0).0,
        covariance: state.fusion.covariance() + Matrix2::identity() * sway_2,
        laws,
    };
    observer.measure(&f.observer, f.ki_1_s, &measured);
    publish(config, state);
}

/// Publishes the gains: k_ε of the straight line through the learned curve of each channel over the range it has shown, within the
/// bounds of the refinement, and k_λ.
fn publish(config: &LoopConfig, state: &mut LoopState) {
    if !config.refine.enabled || config.feedforward.is_some() {
        return;
    }
    let (observer, theta) = (&state.observer, state.observer.theta());
    for i in 0..3 {
        state.shown[i] = f64::max(state.shown[i], observer.now.v[i].abs());
        let slope = 1.0 + theta[GAIN + i] + CUBIC * theta[ODD + i] * state.shown[i].powi(2);
        let [[least, most], _] = config.refine.bounds(&config.lines[i]);
        let k_epsilon = (1.0 + observer.lines[i].k_epsilon) / slope.max(0.1) - 1.0;
        state.lines[i] = Line {
            k_epsilon: k_epsilon.clamp(least, most),
            k_lambda_mm: observer.lines[i].k_lambda_mm,
        };
    }
}
