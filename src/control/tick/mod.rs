//! ★ One tick of the control loop: `tick(&LoopConfig, &mut LoopState, &Input) -> Frame`.
//!
//! ```text
//! ImuSample ─ fusion ─▶ estimated bend ─┐
//! target ─ profile ─▶ set-point         ▼
//! steps ─ play, 1/(1+k_ε) ─▶ bend from pistons ─ lag, dead time ─▶ predicted bend ─▶ error ─ PI ─▶ feedback
//! set-point + feedback ─▶ bend command ─ arc ─▶ bellow lengths ─ transmission⁻¹ ─▶ piston targets ─ limits ─▶ steps
//! ```
//!
//! The tick neither allocates, locks nor reads a clock. Hardware, simulation and replay run the same function and get
//! the same bits.

mod feedback;
mod observation;
mod path;
mod pistons;
mod restart;
mod sense;
mod setpoint;
mod state;
mod types;

pub use restart::{RestartRest, RestartState};
pub use state::LoopState;
pub use types::{Command, FeedbackConfig, Frame, Input, LoopConfig, Reference, Senses, TickPhase};

use crate::control::limits::Cut;
use crate::estimation::fusion::health::HealthAction;
use crate::estimation::fusion::tip::TipEstimate;
use crate::model::{Bend, Shape};
use crate::primitives::Mm;
use observation::Observation;
use pistons::PistonOutput;

/// One tick of the loop.
pub fn tick(config: &LoopConfig, state: &mut LoopState, input: &Input) -> Frame {
    sense::estimate(config, state, input);
    let from_pistons = pistons::follow_steps(config, state, &input.steps, input.dt_s);
    let Some(estimate) = state.fusion.estimate() else {
        return frame(
            config,
            state,
            input,
            &Observation::without_estimate(from_pistons),
            PistonOutput::resting(state),
        );
    };
    let bend = estimate.bend;
    state.setpoint.target_rests_s += input.dt_s;
    if let Some(command) = input.command {
        state.setpoint.target = Shape {
            bend: command.bend,
            length: command.length,
        };
        state.setpoint.target_rests_s = 0.0;
    }
    let holding = feedback::hold(config, state, &input.steps);
    let setpoint_cut = if holding {
        Cut::None
    } else {
        feedback::advance_setpoint(config, state, input)
    };
    let moving = !state.setpoint.has_arrived();
    let predicted_before = state.feedback.model.predicted();
    let predicted = state
        .feedback
        .model
        .step(from_pistons.0, &state.dynamics.best, input.dt_s);
    sense::watch_base(config, state, input, predicted, bend);
    let observation = Observation {
        estimate: Some(estimate),
        from_pistons,
        predicted,
        predicted_rate: (predicted - predicted_before).norm() / input.dt_s.max(f64::MIN_POSITIVE),
        unexplained: predicted - bend.0,
        settled: bend.0 + from_pistons.0 - predicted,
    };
    let departs = (moving || holding) && !state.feedback.moving;
    feedback::feed_back(config, state, &observation, moving || holding, input.dt_s);
    if config.feedback.is_some() && !holding && !state.base.moved {
        feedback::learn(config, state, &observation, bend, departs, input.dt_s);
    }
    let mut output = pistons::command(config, state, bend, moving, input.dt_s);
    feedback::monitor_saturation(
        config,
        state,
        bend,
        moving || holding,
        output.cut,
        input.dt_s,
    );
    if output.cut == Cut::None {
        output.cut = setpoint_cut;
    }
    frame(config, state, input, &observation, output)
}

fn frame(
    config: &LoopConfig,
    state: &LoopState,
    input: &Input,
    observation: &Observation,
    output: PistonOutput,
) -> Frame {
    let &Observation {
        estimate,
        from_pistons,
        predicted,
        unexplained,
        ..
    } = observation;
    let phase = match estimate {
        None => TickPhase::Aligning,
        Some(_) if state.setpoint.has_arrived() => TickPhase::Holding,
        Some(_) => TickPhase::Tracking,
    };
    Frame {
        t: input.t,
        phase,
        target: state.setpoint.target,
        setpoint: Shape {
            bend: Bend(state.setpoint.bend.at),
            length: Mm(state.setpoint.length.at.x),
        },
        estimate,
        bend_from_pistons: from_pistons,
        predicted,
        unexplained,
        feedback: state.feedback.feedback,
        command: output.command,
        bellow_mm: output.bellow_mm,
        piston_target_mm: output.piston_target_mm,
        steps: config.drive.steps(&output.piston_target_mm),
        k_epsilon: state.transmission.lines.map(|l| l.k_epsilon),
        k_lambda_mm: state.transmission.lines.map(|l| l.k_lambda_mm),
        dynamics: state.dynamics.best,
        cut: output.cut,
        at_rest: state.feedback.standstill.closed,
        blocked: state.feedback.obstruction.blocked,
        hunting: state.feedback.hunting.hunting,
        integral_s: state.feedback.integral_s,
        saturation: state.feedback.saturation.now(),
        senses: senses(state, estimate),
        base_moved: state.base.moved,
        base_doubted: state.fusion.suspects_base_motion(&config.fuse),
    }
}

fn senses(state: &LoopState, estimate: Option<TipEstimate>) -> Senses {
    Senses {
        action: state
            .fusion
            .verdict()
            .map_or(HealthAction::Use, |v| v.action()),
        in_force: state.fusion.in_force(),
        held: state.hold.is_holding(),
        disagrees: estimate.is_some_and(|e| e.disagrees),
    }
}
