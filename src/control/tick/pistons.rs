//! The command path: bend command → bellow lengths → transmission inverse → limits → paced pistons.

use super::{LoopConfig, LoopState};
use crate::control::backlash_adaptation::Patience;
use crate::control::limits::Cut;
use crate::model::arc::Shape;
use crate::model::bend::Bend;
use crate::model::transmission::Wanted;
use crate::primitives::units::Mm;
use nalgebra::{Vector1, Vector2, Vector3};

/// Time constant with which targets leave a hold, s.
const EASE_S: f64 = 0.15;

/// What the command path of one tick came to.
pub(super) struct PistonOutput {
    pub(super) error: Vector2<f64>,
    pub(super) bellow_mm: Vector3<f64>,
    pub(super) piston_target_mm: Vector3<f64>,
    pub(super) cut: Cut,
}

impl PistonOutput {
    pub(super) fn resting(state: &LoopState) -> Self {
        Self {
            error: Vector2::zeros(),
            bellow_mm: Vector3::zeros(),
            piston_target_mm: Vector3::from_fn(|i, _| state.pistons[i].at.x),
            cut: Cut::None,
        }
    }
}

/// Bend command → bellow lengths → transmission inverse → limits → paced pistons.
pub(super) fn command_pistons(config: &LoopConfig, state: &mut LoopState, estimate: Bend, moving: bool, dt_s: f64) -> PistonOutput {
    let lead_s = config.feedback.map_or(0.0, |f| f.lead * state.dynamics.lag_s);
    let bend = Bend(state.bend.at + state.bend.velocity * lead_s + state.pi.feedback);
    let length = Mm(state.length.at.x);
    let wanted_mm = config.geometry.lengths(&Shape { bend, length });
    let bellow_mm = wanted_mm.add_scalar(config.limits.relief(&wanted_mm, &state.lines));
    let piston_mm = if let Some(held) = state.held {
        held.stop_mm
    } else if state.rest.closed {
        Vector3::from_fn(|i, _| state.pistons[i].at.x)
    } else {
        invert_transmission(config, state, &bellow_mm, estimate, moving, dt_s)
    };
    let felt_mm = config.geometry.lengths(&Shape { bend: estimate, length });
    let (allowed_mm, cut) = config.limits.pistons(&piston_mm, &felt_mm);
    let piston_target_mm = eased(state, allowed_mm, dt_s);
    for i in 0..3 {
        state.pistons[i].step(&Vector1::new(piston_target_mm[i]), &config.piston_pace, dt_s);
    }
    PistonOutput { error: Vector2::zeros(), bellow_mm, piston_target_mm, cut }
}

/// After a hold the targets leave where the pistons stand without a jump.
fn eased(state: &mut LoopState, target_mm: Vector3<f64>, dt_s: f64) -> Vector3<f64> {
    if let Some(held) = state.held {
        state.ease_mm = held.stop_mm;
        state.easing = true;
        return held.stop_mm;
    }
    if state.easing {
        // the first tick after it: what was a place becomes a difference
        (state.ease_mm, state.easing) = (state.ease_mm - target_mm, false);
    }
    state.ease_mm *= (-dt_s / EASE_S).exp();
    target_mm + state.ease_mm
}

/// Eq. 16 per channel; a reversal asked for by feedback alone jumps the learned share of the gap.
fn invert_transmission(
    config: &LoopConfig,
    state: &mut LoopState,
    bellow_mm: &Vector3<f64>,
    estimate: Bend,
    moving: bool,
    dt_s: f64,
) -> Vector3<f64> {
    let nudging = config.feedback.is_some() && !moving;
    let mut turned = [false; 3];
    let piston_mm = Vector3::from_fn(|i, _| {
        let reach = if nudging { state.reach.share(i) } else { 1.0 };
        let wanted = Wanted { q_mm: bellow_mm[i], dt_s, reach };
        let (u, next) = config.side.invert(&state.lines[i], state.sides[i], &wanted);
        turned[i] = next.way != state.sides[i].way;
        state.sides[i] = next;
        u
    });
    if nudging {
        let answer_s = state.dynamics.delay_s + 3.0 * state.dynamics.lag_s + 0.08;
        let worth_rad = config.feedback.map_or(0.0, |f| f.rest.open_rad);
        let increments = state.reach.step(turned, &(state.target.bend.0 - estimate.0), &Patience { answer_s, worth_rad }, dt_s);
        for (side, increment) in state.sides.iter_mut().zip(increments) {
            side.side = (side.side + 2.0 * increment * side.way).clamp(-1.0, 1.0);
        }
    } else {
        state.reach.forget();
    }
    piston_mm
}
