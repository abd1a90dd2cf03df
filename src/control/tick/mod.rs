//! ★ One tick of the control loop: `tick(&LoopConfig, &mut LoopState, &Input) -> Frame`.
//!
//! ```text
//! sense     ImuSample ─ fusion ─▶ estimated bend
//! observe   steps ─ plays, laws, dead time, lag ─▶ predicted bend ─ Kalman filter with the estimate ─▶ belief: laws, g, σ
//! decide    target ─ profile ─▶ set-point ─ PI on the belief, rule for when to move ─▶ bend of the channels
//! act       ─ inverse of the belief, free common length ─▶ piston targets ─ limits ─▶ steps
//! ```
//!
//! The tick neither allocates, locks nor reads a clock. Hardware, simulation and replay run the same function and get
//! the same bits.

mod crossing;
mod decide;
mod observe;
mod restart;
mod sense;
mod setpoint;
mod state;
mod types;

pub use restart::{RestartRest, RestartState};
pub use state::LoopState;
pub use types::{
    Belief, FeedbackConfig, Frame, Input, LoopConfig, Reference, SETTLED_DEG, Senses, TickPhase,
};

use crate::control::limits::Cut;
use crate::estimation::fusion::health::HealthAction;
use crate::estimation::fusion::tip::TipEstimate;
use crate::model::Bend;
use decide::{Decided, Decision};
use nalgebra::Vector2;

/// One tick of the loop.
pub fn tick(config: &LoopConfig, state: &mut LoopState, input: &Input) -> Frame {
    sense::estimate(config, state, input);
    observe::follow_steps(config, state, &input.steps, input.dt_s);
    let Some(estimate) = state.fusion.estimate() else {
        return frame(config, state, input, None, &Decided::default());
    };
    let (bend, dt_s) = (estimate.bend, input.dt_s);
    state.setpoint.target_rests_s += dt_s;
    if let Some(target) = input.command {
        (state.setpoint.target, state.setpoint.target_rests_s) = (target, 0.0);
    }
    let holding = decide::hold(config, state, &input.steps);
    let setpoint_cut = if holding {
        Cut::None
    } else {
        decide::advance_setpoint(config, state, input)
    };
    let moving = !state.setpoint.has_arrived();
    depart(config, state, moving, input.suspected);
    sense::watch_base(config, state, input, bend);
    state.attribute_to_base(dt_s);
    if !holding && !state.base.moved && !input.idle {
        observe::learn(config, state, &estimate, moving, dt_s);
    }
    state.last_estimate = bend.0;
    let mut decision = Decision {
        config,
        state: &mut *state,
        estimate: bend.0,
        dt_s,
    };
    let mut decided = decision.command(moving);
    decision.watch(moving || holding, decided.cut);
    if decided.cut == Cut::None {
        decided.cut = setpoint_cut;
    }
    frame(config, state, input, Some(estimate), &decided)
}

/// When the set-point begins to move.
fn depart(config: &LoopConfig, state: &mut LoopState, moving: bool, suspected: bool) {
    if moving && !state.moving {
        if !state.obstruction.blocked {
            state.remember();
            if !suspected {
                state.accept_lines(config);
            }
        }
        state.observer.depart();
        state.rule.depart();
    }
    state.moving = moving;
}

fn frame(
    config: &LoopConfig,
    state: &LoopState,
    input: &Input,
    estimate: Option<TipEstimate>,
    decided: &Decided,
) -> Frame {
    let phase = match estimate {
        None => TickPhase::Aligning,
        Some(_) if state.setpoint.has_arrived() => TickPhase::Holding,
        Some(_) => TickPhase::Tracking,
    };
    let dynamics = state.observer.dynamics;
    let predicted = state.observer.predicted();
    Frame {
        t: input.t,
        phase,
        target: state.setpoint.target,
        setpoint: state.setpoint.shape(),
        estimate,
        bend_from_pistons: Bend(state.played()),
        predicted,
        unexplained: estimate.map_or_else(Vector2::zeros, |e| predicted - e.bend.0),
        feedback: state.feedback,
        command: decided.command,
        bellow_mm: decided.bellow_mm,
        piston_target_mm: state.targets_mm,
        steps: config.drive.steps(&state.targets_mm),
        k_epsilon: state.lines.map(|l| l.k_epsilon),
        k_lambda_mm: state.lines.map(|l| l.k_lambda_mm),
        dynamics,
        cut: decided.cut,
        at_rest: phase == TickPhase::Holding
            && state.rule.rests_s > dynamics.delay_s + 3.0 * dynamics.lag_s,
        blocked: state.obstruction.blocked,
        belief: belief(state),
        saturation: state.saturation.reported,
        senses: senses(state, estimate),
        base_moved: state.base.moved,
        base_doubted: state.fusion.suspects_base_motion(&config.fuse),
    }
}

fn belief(state: &LoopState) -> Belief {
    let observer = &state.observer;
    Belief {
        settled: observer.settled_by_laws() + observer.residual(),
        sigma_rad: observer.settled_sigma(&observer.known),
        residual: observer.residual(),
        line_sigmas: state.line_sigmas(),
        response_error_s: state.dynamics.error_max_s(),
        periodic_hz: state.periodic.hertz(),
    }
}

fn senses(state: &LoopState, estimate: Option<TipEstimate>) -> Senses {
    let fusion = &state.fusion;
    Senses {
        action: fusion.verdict().map_or(HealthAction::Use, |v| v.action()),
        in_force: fusion.in_force(),
        held: state.hold.is_holding(),
        disagrees: estimate.is_some_and(|e| e.disagrees),
    }
}
