//! The deciding half of the tick: set-point, belief and rule, down to the pistons.

use super::path::{self, Passing};
use super::state::{Hold, LoopState};
use super::types::{FeedbackConfig, Input, LoopConfig};
use crate::control::follow::Follower;
use crate::control::inverse::{self, Choice};
use crate::control::limits::Cut;
use crate::control::observer::laws::{ROTATION, bend_of};
use crate::control::rule;
use crate::model::{Bend, Shape, Wanted};
use crate::primitives::{Mm, Steps};
use nalgebra::{Vector1, Vector2, Vector3};

/// Share of the pace by which the lead may raise the speed of the command: pistons that follow the pace have that much to
/// spare.
const LEAD_SHARE: f64 = 0.35;
/// Longest time between two targets of a stream, s; a target that has lasted for longer is at rest.
const STREAM_PERIOD_S: f64 = 0.1;
/// Lag from which a line is slow: twice the time for which a reversal stops the tip, s.
const SLOW_S: f64 = 0.16;
/// Time constant with which the offset after a hold decays, s.
const EASE_S: f64 = 0.15;

/// Result of the command path.
pub(super) struct PistonOutput {
    pub(super) command: Bend,
    pub(super) bellow_mm: Vector3<f64>,
    pub(super) piston_target_mm: Vector3<f64>,
    pub(super) cut: Cut,
}

impl PistonOutput {
    /// The pistons stay at their targets.
    pub(super) fn resting(state: &LoopState) -> Self {
        Self {
            command: Bend::STRAIGHT,
            bellow_mm: Vector3::zeros(),
            piston_target_mm: state.targets_mm,
            cut: Cut::None,
        }
    }
}

/// Decides whether the pistons must stand: during a re-alignment, and in closed loop without a usable sensor. At the
/// beginning of a hold each piston stops within its braking distance; afterwards the targets start from where it stands.
pub(super) fn hold(config: &LoopConfig, state: &mut LoopState, steps: &Steps) -> bool {
    let blind = state.fusion.hold() && config.feedback.is_some();
    let must_hold = blind || state.fusion.realigning();
    state.hold = match state.hold {
        Hold::Holding { stop_mm } if !must_hold => Hold::Leaving { stop_mm },
        Hold::Released { .. } | Hold::Leaving { .. } if must_hold => {
            state.setpoint.bend = Follower::resting(state.setpoint.bend.at);
            state.setpoint.length = Follower::resting(state.setpoint.length.at);
            // a target beyond the braking distance is given up; one within it is where the piston stops anyway
            let (at_mm, reach_mm) = (config.drive.piston_mm(steps), config.motion.braking_mm());
            let stop_mm =
                at_mm + (state.targets_mm - at_mm).map(|to_go| to_go.clamp(-reach_mm, reach_mm));
            Hold::Holding { stop_mm }
        }
        unchanged => unchanged,
    };
    must_hold
}

/// Moves the set-point towards the target. Both stay within the range of the bellows.
pub(super) fn advance_setpoint(config: &LoopConfig, state: &mut LoopState, input: &Input) -> Cut {
    let dt_s = input.dt_s;
    let mut pace = config.bend_pace;
    if config.feedback.is_some() {
        // the feedforward leads a slow line by τ r̈; a gentler start keeps that within the pace of the pistons
        pace.acceleration = pace
            .acceleration
            .min(LEAD_SHARE * pace.speed / lead_s(config, state).max(1e-3));
    }
    if let Some(reference) = &input.reference {
        return path::advance(config, state, reference, &pace, dt_s);
    }
    let setpoint = &mut state.setpoint;
    setpoint.acceleration = None;
    let (q, cut) = config.limits.bellows(
        &config.geometry.lengths(&setpoint.target),
        config.geometry.rest_length_mm,
    );
    if cut != Cut::None {
        setpoint.target = config.geometry.shape(&q);
    }
    let pace = setpoint.brake(&pace);
    setpoint.bend.step(&setpoint.target.bend.0, &pace, dt_s);
    setpoint.length.step(
        &Vector1::new(setpoint.target.length.0),
        &config.length_pace,
        dt_s,
    );
    cut
}

/// Time by which the feedforward leads the set-point, s.
fn lead_s(config: &LoopConfig, state: &LoopState) -> f64 {
    config
        .feedback
        .map_or(0.0, |f| f.lead * state.observer.dynamics.lag_s)
}

/// What the feedforward adds to the set-point, rad. Beyond a target at rest it would have to come back, and a reversal
/// crosses the backlash: there it ends at the target, unless the line is so slow that the tip gains more by the lead than
/// it loses by the reversal.
fn ahead(state: &LoopState, lead_s: f64) -> Vector2<f64> {
    let setpoint = &state.setpoint;
    let ahead = setpoint.bend.velocity * lead_s;
    let to_go = (setpoint.target.bend.0 - setpoint.bend.at).norm();
    if setpoint.target_rests_s > STREAM_PERIOD_S && ahead.norm() > to_go && lead_s < SLOW_S {
        ahead.cap_magnitude(to_go)
    } else {
        ahead
    }
}

/// Commands the pistons.
pub(super) fn command(
    config: &LoopConfig,
    state: &mut LoopState,
    estimate: Bend,
    moving: bool,
    dt_s: f64,
) -> PistonOutput {
    let length = Mm(state.setpoint.length.at.x);
    if config.feedback.is_some() && state.setpoint.acceleration.is_none() {
        // a path goes on from the sides on which the pistons push
        state.push_sides();
    }
    let command = match &config.feedback {
        None => open_loop(config, state, dt_s),
        Some(f) if moving => track(config, f, state, &estimate.0, dt_s),
        // what the base has done is not corrected
        Some(_) if state.base.moved => state.setpoint.bend.at + state.feedback,
        Some(f) => correct(config, f, state, &estimate.0, dt_s),
    };
    let wanted_mm = match state.hold {
        Hold::Holding { stop_mm } => stop_mm,
        _ => state.rule.aim_mm,
    };
    let (allowed_mm, cut) = allowed(config, state, &estimate.0, wanted_mm);
    state.rule.goal_mm = allowed_mm;
    state.targets_mm = match &config.feedback {
        _ if state.hold.is_holding() => allowed_mm,
        Some(f) if !moving && !state.obstruction.blocked && state.periodic.hertz().is_none() => {
            let error_rad = (state.setpoint.target.bend.0 - estimate.0).norm();
            let slow_mm =
                state
                    .rule
                    .slowly(&f.calm, &state.observer, &state.targets_mm, error_rad, dt_s);
            ease(&mut state.hold, slow_mm, dt_s)
        }
        _ => ease(&mut state.hold, allowed_mm, dt_s),
    };
    PistonOutput {
        command: Bend(command),
        bellow_mm: config.geometry.lengths(&Shape {
            bend: Bend(command),
            length,
        }),
        piston_target_mm: state.targets_mm,
        cut,
    }
}

/// Targets with the offset that remains of a hold, so that they leave it without a jump.
fn ease(hold: &mut Hold, target_mm: Vector3<f64>, dt_s: f64) -> Vector3<f64> {
    let mut offset_mm = match *hold {
        Hold::Holding { stop_mm } | Hold::Leaving { stop_mm } => stop_mm - target_mm,
        Hold::Released { offset_mm } => offset_mm,
    };
    offset_mm *= (-dt_s / EASE_S).exp();
    *hold = Hold::Released { offset_mm };
    target_mm + offset_mm
}

/// The paper's open loop: Eq. 16 for the set-point, through a described machine if there is one.
fn open_loop(config: &LoopConfig, state: &mut LoopState, dt_s: f64) -> Vector2<f64> {
    let bend = state.setpoint.bend.at;
    let length = Mm(state.setpoint.length.at.x);
    let wanted_mm = config.geometry.lengths(&Shape {
        bend: Bend(bend),
        length,
    });
    let mut bellow_mm = wanted_mm.add_scalar(config.limits.relief(&wanted_mm, &state.lines));
    let mut described = config.feedforward.as_deref().zip(state.described.as_mut());
    if let Some((machine, state)) = &mut described {
        bellow_mm = state.invert(machine, &bellow_mm);
    }
    let piston_mm = Vector3::from_fn(|i, _| {
        let wanted = Wanted {
            q_mm: bellow_mm[i],
            dt_s,
        };
        let (piston_mm, next) = config.side.invert(&state.lines[i], state.sides[i], &wanted);
        state.sides[i] = next;
        piston_mm
    });
    state.rule.aim_mm = described.map_or(piston_mm, |(machine, state)| {
        state.counted(machine, &piston_mm)
    });
    bend
}

/// The set-point moves: the pistons make the bend by which the tip is there once the lag has passed.
fn track(
    config: &LoopConfig,
    f: &FeedbackConfig,
    state: &mut LoopState,
    estimate: &Vector2<f64>,
    dt_s: f64,
) -> Vector2<f64> {
    let lead_s = lead_s(config, state);
    let at = state.setpoint.bend.at + ahead(state, lead_s);
    let observer = &state.observer;
    // g belongs to where the tip is; at the end of the motion less of it is left
    let to_go = (at - observer.settled_by_laws() - observer.residual()).norm();
    let share = (-to_go / f.observer.residual_path_deg.to_radians()).exp();
    let bend = rule::needed(observer, &at, share, &state.disturbed());
    let bend = limited(f, state, &at, &bend);
    let bend = bounded(config, f, state, bend, estimate);
    state.feedback = bend - state.setpoint.bend.at;
    let nominal = through_machine(config, state, &bend);
    match path::bellow_motion(config, &state.setpoint, lead_s) {
        Some(motion) => follow(config, f, state, &nominal, &motion, estimate, dt_s),
        None => go(config, f, state, &nominal, None, estimate),
    }
    bend
}

/// The bend of the nominal channels at which a described machine bends by `bend`, less what was learned beside its laws, rad.
fn through_machine(
    config: &LoopConfig,
    state: &mut LoopState,
    bend: &Vector2<f64>,
) -> Vector2<f64> {
    let Some((machine, described)) = config.feedforward.as_deref().zip(state.described.as_mut())
    else {
        return *bend;
    };
    let observer = &state.observer;
    let learned = bend_of(&observer.now.outputs(&observer.theta())) - observer.now.nominal();
    let wanted_mm = config.geometry.lengths(&Shape {
        bend: Bend(bend - learned),
        length: Mm(config.geometry.rest_length_mm + state.rule.length * config.geometry.r_mm),
    });
    let bellow_mm = described.invert(machine, &wanted_mm);
    let play_output_mm = machine.play_outputs(&bellow_mm);
    let v = std::array::from_fn(|i| play_output_mm[i] / observer.mm_per_rad(i));
    bend_of(&v) + learned
}

/// The set-point rests: moves if the rule says so.
fn correct(
    config: &LoopConfig,
    f: &FeedbackConfig,
    state: &mut LoopState,
    estimate: &Vector2<f64>,
    dt_s: f64,
) -> Vector2<f64> {
    let foreseen = foresee(config, state);
    let (believed, given) = (foreseen.believed, foreseen.given);
    let theta = state.observer.theta();
    let error = state.setpoint.target.bend.0 - believed - state.disturbed();
    let bend = given + rule::unrotated(error * f.kp, theta[ROTATION]);
    let at = state.setpoint.bend.at;
    let bend = limited(f, state, &at, &bend);
    let bend = bounded(config, f, state, bend, estimate);
    let change = bend - given;
    let risk = inverse::risk(&state.observer, &change, f.free_length_mm);
    state.rule.answer(
        &state.observer.dynamics,
        estimate,
        state.periodic.hertz().is_some(),
        dt_s,
    );
    let (dynamics, step) = (state.observer.dynamics, f.step_deg.to_radians());
    let worth =
        |rule: &rule::Rule, gain_2: f64| rule.moves(&dynamics, gain_2, risk, step, f.caution);
    if state.hold.is_holding() || !worth(&state.rule, change.norm_squared()) {
        return given;
    }
    let stays = state.rule;
    // a described machine is believed anew in the next tick: the slope of its laws need not be known
    let (wanted, length) = (foreseen.nominal + change, state.rule.length);
    go(config, f, state, &wanted, Some(length), estimate);
    let (allowed_mm, cut) = allowed(config, state, estimate, state.rule.aim_mm);
    if cut != Cut::None {
        let left = error - (state.observer.at(&allowed_mm).0 - believed);
        if !worth(&stays, error.norm_squared() - left.norm_squared()) {
            state.rule = stays;
            return given;
        }
    }
    state.feedback = bend - at;
    state.rule.act(&state.setpoint.target.bend.0);
    bend
}

/// Pistons within the limits of the actuators.
fn allowed(
    config: &LoopConfig,
    state: &LoopState,
    estimate: &Vector2<f64>,
    piston_mm: Vector3<f64>,
) -> (Vector3<f64>, Cut) {
    let estimated_mm = config.geometry.lengths(&Shape {
        bend: Bend(*estimate),
        length: Mm(state.setpoint.length.at.x),
    });
    config.limits.pistons(&piston_mm, &estimated_mm)
}

/// What the pistons cause once they are where they go, rad.
struct Foreseen {
    /// The bend of the tip.
    believed: Vector2<f64>,
    /// The bend of the channels, and of the nominal channels if a described machine bends by others.
    given: Vector2<f64>,
    nominal: Vector2<f64>,
}

fn foresee(config: &LoopConfig, state: &mut LoopState) -> Foreseen {
    let (observer, goal_mm) = (&state.observer, &state.rule.goal_mm);
    let theta = observer.theta();
    let described = config.feedforward.as_deref().zip(state.described.as_mut());
    let Some((machine, described)) = described else {
        let (believed, there) = observer.at(goal_mm);
        let given = bend_of(&there.outputs(&theta));
        return Foreseen {
            believed,
            given,
            nominal: given,
        };
    };
    let (by_nominal, there) = observer.at(&described.pistons_at(machine, goal_mm));
    let bend = described.foresee(machine, &there.play_outputs_mm()).bend.0;
    let nominal = bend_of(&there.outputs(&theta));
    let beside = bend - there.nominal();
    Foreseen {
        believed: by_nominal + bend - (observer.given() + there.nominal() - observer.now.nominal()),
        given: nominal + beside,
        nominal,
    }
}

/// The bend, no further from the estimate than an obstruction permits.
fn bounded(
    config: &LoopConfig,
    f: &FeedbackConfig,
    state: &LoopState,
    bend: Vector2<f64>,
    estimate: &Vector2<f64>,
) -> Vector2<f64> {
    if !state.obstruction.blocked {
        return bend;
    }
    let stiffest = state
        .lines
        .iter()
        .map(|l| 1.0 + l.k_epsilon)
        .fold(1.0, f64::max);
    let kpa_per_rad = config.limits.pressure_kpa_per_mm * stiffest * config.geometry.r_mm;
    estimate + (bend - estimate).cap_magnitude(f.obstruction.press_kpa / kpa_per_rad)
}

/// Chooses sides and common length for a bend of the channels, and aims the pistons there.
fn go(
    config: &LoopConfig,
    f: &FeedbackConfig,
    state: &mut LoopState,
    bend: &Vector2<f64>,
    keep: Option<f64>,
    estimate: &Vector2<f64>,
) {
    let (choice, aim_mm) = choose(config, f, state, bend, keep, estimate);
    state.rule.length = choice.length;
    aim(config, state, aim_mm);
}

/// Aims the pistons, as counted.
fn aim(config: &LoopConfig, state: &mut LoopState, piston_mm: Vector3<f64>) {
    let described = config.feedforward.as_deref().zip(state.described.as_mut());
    state.rule.aim_mm = described.map_or(piston_mm, |(machine, described)| {
        described.counted(machine, &piston_mm)
    });
}

/// The bend of the channels, no further from `at` than the bound of the correction.
fn limited(
    config: &FeedbackConfig,
    state: &mut LoopState,
    at: &Vector2<f64>,
    bend: &Vector2<f64>,
) -> Vector2<f64> {
    let (most, correction) = (config.integral_max_deg.to_radians(), bend - at);
    state.feedback_full = correction.norm() > most;
    at + correction.cap_magnitude(most)
}

fn choose(
    config: &LoopConfig,
    f: &FeedbackConfig,
    state: &LoopState,
    bend: &Vector2<f64>,
    keep: Option<f64>,
    estimate: &Vector2<f64>,
) -> (Choice, Vector3<f64>) {
    let theta = state.observer.theta();
    let (_, there) = state.observer.at(&state.rule.goal_mm);
    let from = inverse::From {
        observer: &state.observer,
        limits: &config.limits,
        there: &there,
        theta: &theta,
        estimate,
        keep,
        length: (state.setpoint.length.at.x - config.geometry.rest_length_mm)
            / config.geometry.r_mm,
        free_mm: f.free_length_mm,
    };
    let choice = inverse::choose(&from, bend);
    let aim_mm = inverse::pistons(&from, &choice, &state.rule.aim_mm);
    (choice, aim_mm)
}

/// A moving reference: the pistons pass where the set-point is, and cross their backlash where the reference turns.
fn follow(
    config: &LoopConfig,
    f: &FeedbackConfig,
    state: &mut LoopState,
    bend: &Vector2<f64>,
    motion: &[Vector3<f64>; 2],
    estimate: &Vector2<f64>,
    dt_s: f64,
) {
    let (choice, _) = choose(
        config,
        &FeedbackConfig {
            free_length_mm: 0.0,
            ..*f
        },
        state,
        bend,
        None,
        estimate,
    );
    state.rule.length = choice.length;
    let observer = &state.observer;
    let theta = observer.theta();
    let piston_mm = Vector3::from_fn(|i, _| {
        let factor = observer.mm_per_rad(i) / config.geometry.r_mm;
        let passing = Passing {
            w_mm: observer.now.solve(i, choice.outputs[i], &theta) * observer.mm_per_rad(i),
            speed: motion[0][i] * factor,
            acceleration: motion[1][i] * factor,
        };
        let half_width_mm = observer.lines[i].k_lambda_mm;
        let (piston_mm, next) = path::invert(
            half_width_mm,
            state.sides[i],
            &passing,
            &config.motion.limits,
            dt_s,
        );
        state.sides[i] = next;
        piston_mm
    });
    aim(config, state, piston_mm);
}
