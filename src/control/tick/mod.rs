//! ★ The whole loop on one page: `tick(&Config, &mut State, &Input) -> Frame`.
//!
//! ```text
//! ImuSample ─ fuse ─▶ felt bend ─┐
//! set-point ─ profile ─▶ wanted bend ─▶ error ─ PI ─▶ bend command ─ arc ─▶ bellow lengths
//!                                                   ─ transmission⁻¹ ─▶ piston targets ─ limits, pace ─▶ microsteps
//! microsteps ─ play, 1/(1+k_ε) ─▶ bend the pistons should give ─▶ reference for the error, rows for k_ε
//! ```
//!
//! Nothing here allocates, locks, blocks or asks for the time: the same function runs on hardware, in
//! simulation and in replay, bit for bit.

mod pistons;
mod state;
mod types;

pub use state::{LoopState, RestartRest, RestartState};
pub use types::{Command, FeedbackConfig, Frame, Input, LoopConfig, Senses, TickPhase};

use crate::control::follow::Follower;
use crate::control::limits::Cut;
use crate::control::pi::PiGains;
use crate::control::standstill::StandstillLatch;
use crate::estimation::fusion::base_watch::{Watch, WatchInput};
use crate::estimation::fusion::health::{HealthAction, ImuReading as Reading};
use crate::estimation::fusion::tip::{FusionInput, TipEstimate};
use crate::model::arc::Shape;
use crate::model::bend::Bend;
use crate::model::transmission::{Line, realised};
use crate::primitives::units::Mm;
use nalgebra::{Vector1, Vector2, Vector3};
use pistons::{PistonOutput, command_pistons};
use state::Held;

/// Pistons must have rested this long before the tip counts as still, s.
const STILL_AFTER_S: f64 = 0.5;
/// The rest latch must have been closed this long before a pose teaches k_ε, s.
const LEARN_AFTER_S: f64 = 0.15;

/// One turn of the loop.
pub fn tick(config: &LoopConfig, state: &mut LoopState, input: &Input) -> Frame {
    feel(config, state, input);
    let given = bend_from_pistons(config, state, input);
    let estimate = state.fusion.estimate();
    let Some(estimated_bend) = estimate.map(|f| f.bend) else {
        return frame(config, state, input, None, given, PistonOutput::resting(state));
    };
    if let Some(command) = input.command {
        state.target = Shape { bend: command.bend, length: command.length };
    }
    let holding = hold(config, state);
    let cut_setpoint = if holding { Cut::None } else { advance_setpoint(config, state, input.dt_s) };
    let moving = !state.bend.arrived(&state.target.bend.0);
    let predicted = state.model.step(given.0 - state.pi.feedback, &state.dynamics, input.dt_s);
    watch_base(config, state, input, predicted, estimated_bend);
    let error = feed_back(config, state, predicted, estimated_bend, moving || holding, input.dt_s);
    if config.feedback.is_some() && !holding && !state.base_moved {
        learn(config, state, given, estimated_bend, input.dt_s);
    }
    let mut outcome = command_pistons(config, state, estimated_bend, moving, input.dt_s);
    outcome.error = error;
    if let Some(f) = &config.feedback {
        let off = !state.rest.closed && (state.target.bend.0 - estimated_bend.0).norm() > f.wall.error_rad;
        state.spent.step(moving || holding, off, state.full, outcome.cut, input.dt_s);
    }
    if outcome.cut == Cut::None {
        outcome.cut = cut_setpoint;
    }
    frame(config, state, input, estimate, given, outcome)
}

/// Fusion, told whether the pistons have rested.
fn feel(config: &LoopConfig, state: &mut LoopState, input: &Input) {
    state.still_s = if input.steps == state.last_steps { state.still_s + input.dt_s } else { 0.0 };
    for (idle_s, (now, before)) in state.idle_s.iter_mut().zip(input.steps.0.iter().zip(state.last_steps.0)) {
        *idle_s = if *now == before { *idle_s + input.dt_s } else { 0.0 };
    }
    state.last_steps = input.steps;
    let energised = state.idle_s.map(|s| s < config.motors_idle_after_s);
    let coils_ut = config.motors.as_ref().map_or_else(Vector3::zeros, |m| m.at(&input.steps.0, &energised));
    let tip = match input.imu {
        Reading::Sample(sample, quality) => Reading::Sample(config.imu.apply(&sample), quality),
        other => other,
    };
    let still = state.still_s >= STILL_AFTER_S;
    state.fusion.update(&config.fuse, &FusionInput { now: input.t, tip, base: input.base_imu, coils_ut, still });
}

/// Whether the pistons must stand: the closed loop does not move blindly, nor while it aligns again.
/// Entering a hold brakes each piston at its pace; leaving it, the targets start from where they stand.
fn hold(config: &LoopConfig, state: &mut LoopState) -> bool {
    let blind = state.fusion.hold() && config.feedback.is_some();
    if !blind && !state.fusion.realigning() {
        state.held = None;
        return false;
    }
    if state.held.is_none() {
        let stop_mm = Vector3::from_fn(|i, _| {
            let (at, v) = (state.pistons[i].at.x, state.pistons[i].velocity.x);
            at + v * v.abs() / (2.0 * config.piston_pace.acceleration)
        });
        state.held = Some(Held { stop_mm });
        state.bend = Follower::resting(state.bend.at);
        state.length = Follower::resting(state.length.at);
    }
    true
}

/// The watch for a base that turns, where no base IMU tells; and the request to align again.
fn watch_base(config: &LoopConfig, state: &mut LoopState, input: &Input, predicted: Vector2<f64>, estimate: Bend) {
    // by the play, not as the inverse meant it: what was answered before the flag is taken back through
    // the gap, and need not end where it began
    let played = config.geometry.shape(&bellows_of(&state.lines, &state.play_output_mm)).bend.0;
    let quiet_bend = Bend(state.quiet[1] + played - state.quiet[2]);
    if input.realign {
        state.fusion.realign(if state.base_moved { quiet_bend } else { estimate });
        return;
    }
    if state.fusion.realigning() {
        (state.base_moved, state.watch) = (false, Watch::default());
        return;
    }
    let Some(rate_rad_s) = state.fusion.rate_rad_s().filter(|_| !state.base_moved && !state.fusion.follows_base()) else {
        return;
    };
    let seen = WatchInput {
        rate_rad_s,
        estimate: estimate.0,
        model: predicted + state.pi.feedback,
        setpoint: state.bend.at,
        to_go: state.target.bend.0 - estimate.0,
        still_s: state.still_s,
        answer_s: state.dynamics.lag_s + state.dynamics.delay_s,
        twists: state.fusion.twists(),
        dt_s: input.dt_s,
    };
    state.base_moved = state.watch.step(&config.fuse.watch, &seen);
    if state.base_moved {
        // back to what was right before it turned
        (state.pi.integral, state.pi.feedback) = (state.quiet[0], state.quiet[0]);
    } else if state.watch.quiet() {
        state.quiet = [state.pi.integral, estimate.0, played];
        state.fusion.remember(input.t);
    }
}

/// What the pulses so far have done: the slack by the play operator, which teaches k_ε, and the slack
/// as the inverse meant it, which the error is taken against. They differ while a nudge has jumped
/// only a share of the gap, and then it is the meant one that the integrator must push on.
fn bend_from_pistons(config: &LoopConfig, state: &mut LoopState, input: &Input) -> Bend {
    let piston_mm = config.drive.piston_mm(&input.steps);
    for i in 0..3 {
        state.play_output_mm[i] = state.lines[i].play(state.play_output_mm[i], piston_mm[i]);
        state.realised_mm[i] = realised(&state.lines[i], &state.sides[i], state.realised_mm[i], piston_mm[i]);
    }
    config.geometry.shape(&bellows_of(&state.lines, &state.realised_mm)).bend
}

fn bellows_of(lines: &[Line; 3], play_output_mm: &Vector3<f64>) -> Vector3<f64> {
    Vector3::from_fn(|i, _| lines[i].bellow_mm(play_output_mm[i]))
}

/// Moves the set-point towards the target, both kept within what the bellows can be.
fn advance_setpoint(config: &LoopConfig, state: &mut LoopState, dt_s: f64) -> Cut {
    let (q, cut) = config.limits.bellows(&config.geometry.lengths(&state.target), config.geometry.rest_length_mm);
    if cut != Cut::None {
        state.target = config.geometry.shape(&q);
    }
    let mut pace = config.bend_pace;
    if let Some(f) = &config.feedback {
        // a slow line must be led by τ r̈; softer starts keep that within the pistons' pace
        pace.acceleration = pace.acceleration.min(pace.speed / (f.lead * state.dynamics.lag_s).max(1e-3));
    }
    state.bend.step(&state.target.bend.0, &pace, dt_s);
    state.length.step(&Vector1::new(state.target.length.0), &config.length_pace, dt_s);
    cut
}

/// PI on the bend vector against what the model says should be felt by now. With a base that has
/// moved the error means nothing, and the integrator keeps what it had.
fn feed_back(config: &LoopConfig, state: &mut LoopState, predicted: Vector2<f64>, estimate: Bend, moving: bool, dt_s: f64) -> Vector2<f64> {
    let error = predicted - estimate.0;
    let Some(f) = &config.feedback else {
        return error;
    };
    let to_go = state.target.bend.0 - estimate.0;
    if state.base_moved {
        state.rest = StandstillLatch::default();
        state.pi.feedback = state.pi.integral;
        return error;
    }
    state.rest.step(&f.rest, to_go, moving, dt_s);
    state.rested_s = if state.rest.closed { state.rested_s + dt_s } else { 0.0 };
    let feedback = state.pi.feedback;
    state.wall.step(&f.wall, moving, &feedback, &estimate.0, &to_go);
    if !state.rest.closed && !state.wall.blocked && state.held.is_none() {
        let gains = PiGains::skogestad(&state.dynamics, f.tau_c_s, f.kp_max);
        state.full = state.pi.step(error, &gains, f.integral_max_rad, dt_s);
    }
    error
}

/// Online learners: dynamics while it moves, k_ε from every new held pose.
fn learn(config: &LoopConfig, state: &mut LoopState, given: Bend, estimate: Bend, dt_s: f64) {
    let learns_dynamics = config.feedback.is_some_and(|f| f.learn_dynamics);
    if learns_dynamics {
        state.bank.step(given.0, estimate.0, dt_s);
    }
    let just_settled = state.rested_s >= LEARN_AFTER_S && state.rested_s - dt_s < LEARN_AFTER_S;
    if !just_settled {
        return;
    }
    if let (true, Some(better)) = (learns_dynamics, state.bank.best(&state.dynamics)) {
        state.dynamics = better;
    }
    let q = config.geometry.lengths(&Shape { bend: estimate, length: Mm(state.length.at.x) });
    let learned = state.refine.learn(&config.refine, &state.lines, &estimate.0, &state.play_output_mm, &q);
    if let Some(next) = learned {
        // bumpless: the pistons stay, so the same slack now means another bend command
        let was = config.geometry.shape(&bellows_of(&state.lines, &state.realised_mm)).bend;
        let is = config.geometry.shape(&bellows_of(&next, &state.realised_mm)).bend;
        state.pi.hand_over(is.0 - was.0);
        state.lines = next;
    }
}

fn frame(
    config: &LoopConfig,
    state: &LoopState,
    input: &Input,
    estimate: Option<TipEstimate>,
    given: Bend,
    outcome: PistonOutput,
) -> Frame {
    let mode = match estimate {
        None => TickPhase::Aligning,
        Some(_) if state.bend.arrived(&state.target.bend.0) => TickPhase::Holding,
        Some(_) => TickPhase::Tracking,
    };
    Frame {
        t: input.t,
        mode,
        target: state.target,
        setpoint: Shape { bend: Bend(state.bend.at), length: Mm(state.length.at.x) },
        estimate,
        bend_from_pistons: given,
        error: outcome.error,
        feedback: state.pi.feedback,
        bellow_mm: outcome.bellow_mm,
        piston_target_mm: outcome.piston_target_mm,
        steps: config.drive.steps(&Vector3::from_fn(|i, _| state.pistons[i].at.x)),
        k_epsilon: state.lines.map(|l| l.k_epsilon),
        dynamics: state.dynamics,
        cut: outcome.cut,
        at_rest: state.rest.closed,
        blocked: state.wall.blocked,
        spent: state.spent.now(),
        senses: Senses {
            action: state.fusion.verdict().map_or(HealthAction::Use, |v| v.action()),
            in_force: state.fusion.in_force(),
            held: state.held.is_some(),
            disagrees: estimate.is_some_and(|f| f.disagrees),
        },
        base_moved: state.base_moved,
        base_doubted: state.fusion.doubts_base(&config.fuse),
    }
}
