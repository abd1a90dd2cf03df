//! The command path of the tick: bend command → bellow lengths → transmission inverse → limits → piston targets.

use super::path::{self, Passing};
use super::setpoint::SetPoint;
use super::state::{Hold, LoopState};
use super::types::LoopConfig;
use crate::control::backlash_adaptation::Patience;
use crate::control::limits::Cut;
use crate::model::{Bend, Shape, Wanted, realised};
use crate::primitives::{Mm, Steps};
use nalgebra::{Vector2, Vector3};

/// Longest time between two targets of a stream, s; a target that has lasted for longer is at rest.
const STREAM_PERIOD_S: f64 = 0.1;
/// Lag from which a line is slow: twice the time for which a reversal stops the tip, s.
const SLOW_S: f64 = 2.0 * CROSSING_S;
/// Slope of the learned error that the lead of a slow line relies on.
const LEAD_SLOPE_MAX: f64 = 1.5;
/// Time constant with which the offset after a hold decays, s.
const EASE_S: f64 = 0.15;
/// Time for a piston to cross a backlash of 2 × 0.85 mm from rest with 600 mm/s² up to 30 mm/s, s.
const CROSSING_S: f64 = 0.08;

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

/// Bend that the counted steps cause according to the transmission model. The play operator gives the output from which
/// the gains are learned. The error is taken against the output that the inverse intended: the two differ while a feedback
/// reversal has crossed only a share of the backlash, and then the integrator must act on the intended one.
pub(super) fn follow_steps(
    config: &LoopConfig,
    state: &mut LoopState,
    steps: &Steps,
    dt_s: f64,
) -> Bend {
    let mut piston_mm = config.drive.piston_mm(steps);
    let t = &mut state.transmission;
    let mut described = config.feedforward.as_deref().zip(t.described.as_mut());
    if let Some((machine, state)) = &mut described {
        piston_mm = state.pistons(machine, &piston_mm);
    }
    t.pushes.follow(&piston_mm);
    for i in 0..3 {
        t.play_output_mm[i] = t.lines[i].play(t.play_output_mm[i], piston_mm[i]);
        t.intended_mm[i] = realised(&t.lines[i], &t.sides[i], t.intended_mm[i], piston_mm[i]);
    }
    match described {
        Some((machine, state)) => state.advance(machine, &t.intended_mm, dt_s).bend,
        None => t.intended_shape(&config.geometry).bend,
    }
}

/// Commands the pistons for the set-point plus feedback.
pub(super) fn command(
    config: &LoopConfig,
    state: &mut LoopState,
    estimate: Bend,
    moving: bool,
    dt_s: f64,
) -> PistonOutput {
    let lead_s = lead_s(config, state);
    let setpoint = &state.setpoint;
    let (at, outer) = (setpoint.bend.at, &state.feedback);
    let ahead = at + ahead_of(setpoint, lead_s);
    let bend = Bend(ahead + outer.feedback + outer.error_change(at, ahead, LEAD_SLOPE_MAX));
    let bend = if state.feedback.obstruction.blocked {
        press(config, state, bend, estimate)
    } else {
        bend
    };
    let length = Mm(setpoint.length.at.x);
    let wanted_mm = config.geometry.lengths(&Shape { bend, length });
    let bellow_mm =
        wanted_mm.add_scalar(config.limits.relief(&wanted_mm, &state.transmission.lines));
    let follows = !state.hold.is_holding() && !state.feedback.standstill.closed;
    let piston_mm = match state.hold {
        Hold::Holding { stop_mm } => stop_mm,
        _ if follows => {
            let wanted_mm = invert_transmission(config, state, &bellow_mm, estimate, moving, dt_s);
            calmly(config, state, &wanted_mm, estimate, dt_s)
        }
        _ => state.targets_mm,
    };
    let estimated_mm = config.geometry.lengths(&Shape {
        bend: estimate,
        length,
    });
    let (allowed_mm, cut) = config.limits.pistons(&piston_mm, &estimated_mm);
    state.targets_mm = if follows {
        ease(&mut state.hold, allowed_mm, dt_s)
    } else {
        allowed_mm
    };
    PistonOutput {
        command: bend,
        bellow_mm,
        piston_target_mm: state.targets_mm,
        cut,
    }
}

/// The targets `wanted_mm`, approached no faster than calm corrections permit. Pressure on an obstruction is relieved at once.
fn calmly(
    config: &LoopConfig,
    state: &LoopState,
    wanted_mm: &Vector3<f64>,
    estimate: Bend,
    dt_s: f64,
) -> Vector3<f64> {
    let error_rad = (state.setpoint.target.bend.0 - estimate.0).norm();
    let speed = config
        .feedback
        .and_then(|f| state.feedback.calm.speed(&f.calm, error_rad));
    let Some(speed) = speed.filter(|_| !state.feedback.obstruction.blocked) else {
        return *wanted_mm;
    };
    Vector3::from_fn(|i, _| {
        let most_mm =
            state.transmission.lines[i].play_output_mm(speed * config.geometry.r_mm) * dt_s;
        state.targets_mm[i] + (wanted_mm[i] - state.targets_mm[i]).clamp(-most_mm, most_mm)
    })
}

/// The command against an obstruction: no further from the estimate than the configured pressure, beyond that which the
/// estimated bend needs, allows.
fn press(config: &LoopConfig, state: &LoopState, command: Bend, estimate: Bend) -> Bend {
    let Some(f) = &config.feedback else {
        return command;
    };
    let stiffest = state
        .transmission
        .lines
        .iter()
        .map(|l| 1.0 + l.k_epsilon)
        .fold(1.0, f64::max);
    let kpa_per_rad = config.limits.pressure_kpa_per_mm * stiffest * config.geometry.r_mm;
    Bend(estimate.0 + (command.0 - estimate.0).cap_magnitude(f.obstruction.press_kpa / kpa_per_rad))
}

/// Time by which the feedforward leads the set-point, s.
fn lead_s(config: &LoopConfig, state: &LoopState) -> f64 {
    config
        .feedback
        .map_or(0.0, |f| f.lead * state.dynamics.best.lag_s)
}

/// What the feedforward adds to the set-point, rad. Beyond a target at rest it would have to come back, and a reversal
/// crosses the backlash: there it ends at the target, unless the line is so slow that the tip gains more by the lead than
/// it loses by the reversal.
fn ahead_of(setpoint: &SetPoint, lead_s: f64) -> Vector2<f64> {
    let ahead = setpoint.bend.velocity * lead_s;
    let (way, to_go) = (
        ahead.norm(),
        (setpoint.target.bend.0 - setpoint.bend.at).norm(),
    );
    if setpoint.target_rests_s > STREAM_PERIOD_S && way > to_go && lead_s < SLOW_S {
        ahead * (to_go / way)
    } else {
        ahead
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

/// Eq. 16 per channel. A reversal that feedback alone causes crosses only the learned share of the backlash.
fn invert_transmission(
    config: &LoopConfig,
    state: &mut LoopState,
    bellow_mm: &Vector3<f64>,
    estimate: Bend,
    moving: bool,
    dt_s: f64,
) -> Vector3<f64> {
    let by_feedback = config.feedback.is_some_and(|f| f.learn_backlash) && !moving;
    let motion = path::bellow_motion(config, &state.setpoint, lead_s(config, state));
    let (lines, backlash) = (&mut state.transmission, &mut state.feedback.backlash);
    let mut described = config.feedforward.as_deref().zip(lines.described.as_mut());
    let bellow_mm = described.as_mut().map_or(*bellow_mm, |(machine, state)| {
        state.invert(machine, bellow_mm)
    });
    let mut reversed = [false; 3];
    let piston_mm = Vector3::from_fn(|i, _| {
        let reach = if by_feedback { backlash.share(i) } else { 1.0 };
        let wanted = Wanted {
            q_mm: bellow_mm[i],
            dt_s,
            reach,
        };
        let (piston_mm, next) = match motion {
            Some([speed, acceleration]) => {
                let passing = Passing {
                    q_mm: bellow_mm[i],
                    speed: speed[i],
                    acceleration: acceleration[i],
                };
                path::invert(
                    &lines.lines[i],
                    lines.sides[i],
                    &passing,
                    &config.motion.limits,
                    dt_s,
                )
            }
            None => config.side.invert(&lines.lines[i], lines.sides[i], &wanted),
        };
        reversed[i] = next.way != lines.sides[i].way;
        lines.sides[i] = next;
        piston_mm
    });
    let piston_mm = described.map_or(piston_mm, |(machine, state)| {
        state.counted(machine, &piston_mm)
    });
    // a piston that crosses slowly is answered late
    if !by_feedback
        || config
            .feedback
            .is_some_and(|f| state.feedback.calm.is_calm(&f.calm))
    {
        backlash.forget();
    } else {
        adapt_backlash(config, state, reversed, estimate, dt_s);
    }
    piston_mm
}

/// Judges the backlash by what the tip does after a reversal, and moves each play on by what is missing or too much.
fn adapt_backlash(
    config: &LoopConfig,
    state: &mut LoopState,
    reversed: [bool; 3],
    estimate: Bend,
    dt_s: f64,
) {
    let answer_s = state.dynamics.best.delay_s + 3.0 * state.dynamics.best.lag_s + CROSSING_S;
    let worth_rad = config
        .feedback
        .map_or(0.0, |f| f.standstill.open_deg.to_radians());
    // at its limit the feedback can correct nothing
    let error = if state.feedback.integral_full {
        Vector2::zeros()
    } else {
        state.setpoint.target.bend.0 - estimate.0
    };
    let increments = state.feedback.backlash.step(
        reversed,
        &error,
        &Patience {
            answer_s,
            worth_rad,
        },
        dt_s,
    );
    for (side, increment) in state.transmission.sides.iter_mut().zip(increments) {
        side.side = (side.side + 2.0 * increment * side.way).clamp(-1.0, 1.0);
    }
}
