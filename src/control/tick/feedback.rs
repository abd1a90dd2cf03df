//! The outer loop of the tick: set-point, PI feedback and online learning.

use super::observation::Observation;
use super::path;
use super::state::{Feedback, Hold, LoopState, Taught};
use super::types::{FeedbackConfig, Input, LoopConfig};
use crate::control::follow::Follower;
use crate::control::learning::online::HeldPose;
use crate::control::learning::sides::Sides;
use crate::control::learning::static_error::Observed;
use crate::control::limits::Cut;
use crate::control::pi::{PiGains, PiState};
use crate::control::standstill::StandstillLatch;
use crate::model::{Bend, Shape};
use crate::primitives::{Mm, Steps};
use nalgebra::{Vector1, Vector2, Vector3};

/// Share of the pace by which the lead may raise the speed of the command: pistons that follow the pace have that much to
/// spare.
const LEAD_SHARE: f64 = 0.35;
/// Error of the timing of the prediction that no evidence removes, s, and its share of the response time.
const TIMING_S: f64 = 0.01;
const TIMING_SHARE: f64 = 0.05;
/// Time for which the tip must have twisted without bending until the base sways, s.
const SWAYS_S: f64 = 2.0;
/// The same after the base has moved, s: twice the time for which one turn lets the mean square of the twist grow.
const TURN_S: f64 = 7.0;
/// Time after the standstill latch has closed at which a pose is used for learning, s.
const LEARN_AFTER_S: f64 = 0.15;

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
    if let Some(f) = &config.feedback {
        // the feedforward leads a slow line by τ r̈; a gentler start keeps that within the pace of the pistons
        pace.acceleration = pace
            .acceleration
            .min(LEAD_SHARE * pace.speed / (f.lead * state.dynamics.best.lag_s).max(1e-3));
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

/// PI feedback on what the model and its learned error do not explain. After the base has moved that is meaningless: the
/// integral part keeps its value in that pose, and later poses have the feedforward and what was learned before.
pub(super) fn feed_back(
    config: &LoopConfig,
    state: &mut LoopState,
    observed: &Observation,
    moving: bool,
    dt_s: f64,
) {
    let Some(f) = &config.feedback else { return };
    depart(state, moving);
    watch_sway(config, state, dt_s);
    let outer = &mut state.feedback;
    outer.calm.step(moving, dt_s);
    if state.base.moved {
        outer.standstill = StandstillLatch::default();
        outer.pi.feedback = outer.pi.integral;
        outer.feedback = outer.pi.feedback + outer.error.at(&state.setpoint.bend.at);
        return;
    }
    let to_go = state.setpoint.target.bend.0 - observed.settled;
    settle(f, state, observed, &to_go, moving, dt_s);
    let timing_s = TIMING_S + TIMING_SHARE * state.dynamics.best.response_s();
    if f.learn_error && !state.feedback.obstruction.blocked {
        learn_error(config, state, observed, timing_s, dt_s);
    }
    if state.feedback.standstill.closed || state.hold.is_holding() {
        return;
    }
    let (outer, dynamics) = (&mut state.feedback, &state.dynamics);
    let (gains, timing_s) = match state.setpoint.acceleration {
        // an error of timing is part of the error of a path, so the feedback takes it too
        Some(_) => (
            PiGains::following(dynamics, f.tau_c_s, f.kp_max, outer.hunting.caution),
            0.0,
        ),
        None => (
            PiGains::new(dynamics, f.tau_c_s, f.kp_max, outer.hunting.caution),
            timing_s,
        ),
    };
    outer.integral_s = gains.integral_s;
    let before = outer.pi;
    let (setpoint, estimate) = (
        state.setpoint.bend.at,
        observed.predicted - observed.unexplained,
    );
    let learned =
        outer.error.expected(&setpoint) + outer.error_change(setpoint, estimate, SLOPE_MAX);
    let unexplained = (observed.unexplained - learned)
        * if outer.sways {
            state.base.watch.share_of_tip()
        } else {
            1.0
        };
    let (timing, integral_max) = (
        timing_s * observed.predicted_rate,
        f.integral_max_deg.to_radians(),
    );
    outer.integral_full = outer
        .pi
        .step(unexplained, timing, &gains, integral_max, dt_s);
    if outer.obstruction.blocked && outer.pi.integral.norm() > before.integral.norm() {
        outer.pi = before;
    }
    outer.feedback = outer.pi.feedback + outer.error.at(&setpoint);
}

/// Whether the tip hunts, is disturbed, stands or is obstructed.
fn settle(
    f: &FeedbackConfig,
    state: &mut LoopState,
    observed: &Observation,
    to_go: &Vector2<f64>,
    moving: bool,
    dt_s: f64,
) {
    let outer = &mut state.feedback;
    if !moving {
        let estimate = observed.predicted - observed.unexplained;
        outer
            .hunting
            .step(state.setpoint.target.bend.0 - estimate, observed.predicted);
    }
    outer
        .standstill
        .step(&f.standstill, outer.hunting.band_rad, *to_go, moving, dt_s);
    outer.standstill_s = if outer.standstill.closed {
        outer.standstill_s + dt_s
    } else {
        0.0
    };
    outer.obstruction.step(
        &f.obstruction,
        moving,
        &outer.feedback,
        &observed.settled,
        to_go,
    );
}

/// Learns the static error of the model, and on a path the half-width of the backlash.
fn learn_error(
    config: &LoopConfig,
    state: &mut LoopState,
    observed: &Observation,
    timing_s: f64,
    dt_s: f64,
) {
    let seen = Observed {
        bend: observed.predicted - observed.unexplained,
        unexplained: observed.unexplained,
        rate: observed.predicted_rate,
        sides: Vector3::from_fn(|i, _| state.transmission.sides[i].side),
        follows: state.setpoint.acceleration.is_some(),
        sway2: if state.feedback.sways {
            state.base.watch.sway_mean_square()
        } else {
            0.0
        },
        timing_s: timing_s + state.dynamics.error_max_s(),
        response_s: state.dynamics.response_max_s,
    };
    let changed = state.feedback.error.learn(&seen, dt_s);
    state.feedback.pi.hand_over(-changed);
    if seen.follows && config.refine.enabled && config.feedforward.is_none() {
        let shift = state
            .transmission
            .widen(config, &state.feedback.error.take_backlash());
        state.feedback.pi.hand_over(shift);
        state.shift_model(shift);
    }
}

/// Slope of the learned error that the loop relies on. Where it is −1, the set-point would never be reached.
const SLOPE_MAX: f64 = 0.4;

impl Feedback {
    /// Change of the learned error from one bend to another, per bend at most `slope_max`.
    pub(super) fn error_change(
        &self,
        from: Vector2<f64>,
        to: Vector2<f64>,
        slope_max: f64,
    ) -> Vector2<f64> {
        (self.error.at(&to) - self.error.at(&from)).cap_magnitude(slope_max * (to - from).norm())
    }
}

/// When the set-point begins to move: keeps the integral part and what was learned. What both have gained against an obstruction says
/// nothing about the next target, so there they start from the last values that were free of it.
fn depart(state: &mut LoopState, moving: bool) {
    let outer = &mut state.feedback;
    if moving && !outer.moving {
        if state.base.moved {
            // it belongs to the pose in which the base turned
            outer.pi = PiState::default();
        } else if outer.obstruction.blocked {
            if let Some(free) = &outer.taught[0] {
                (outer.pi, outer.error) = (free.pi, free.error);
            }
        } else {
            let integral = outer.pi.integral;
            let pi = PiState {
                integral,
                feedback: integral,
            };
            let now = Taught {
                pi,
                error: outer.error,
                refine: state.learning.refine,
                lines: state.transmission.lines,
            };
            outer.taught.rotate_right(1);
            outer.taught[0] = Some(now);
        }
        outer.hunting.new_target();
    }
    outer.moving = moving;
}

/// Whether the base sways: for longer than one turn takes to be flagged.
fn watch_sway(config: &LoopConfig, state: &mut LoopState, dt_s: f64) {
    let (outer, watch) = (&mut state.feedback, &state.base.watch);
    let twists = watch.sway_mean_square() > 0.0;
    let least_s = if state.base.moved {
        outer.sways_s += if watch.sway_grows() { dt_s } else { 0.0 };
        TURN_S
    } else {
        outer.sways_s = if twists { outer.sways_s + dt_s } else { 0.0 };
        SWAYS_S
    };
    let sways = twists && (outer.sways || outer.sways_s > least_s);
    let begins = sways && !std::mem::replace(&mut outer.sways, sways);
    outer.sways = sways;
    if begins {
        // as it was before the sway could have been noticed
        if let Some(taught) = state.feedback.taught.iter().rev().flatten().next().copied() {
            state.return_to(config, &taught);
            (state.feedback.pi, state.feedback.taught) = (taught.pi, Default::default());
        }
    }
    state.feedback.error.doubt(sways);
}

/// Learns the dynamics during motion, and k_ε and k_λ from every new pose in which the tip rests: once it has settled, or at the
/// latest when the set-point `departs`.
pub(super) fn learn(
    config: &LoopConfig,
    state: &mut LoopState,
    observed: &Observation,
    estimate: Bend,
    departs: bool,
    dt_s: f64,
) {
    if config.feedback.is_some_and(|f| f.learn_dynamics) {
        let learning = &mut state.learning;
        if learning
            .bank
            .step(observed.from_pistons.0, estimate.0, dt_s)
        {
            state.dynamics = learning.bank.assess(&learning.before, &state.dynamics);
        }
    }
    let rested_s = state.feedback.standstill_s;
    let just_settled = rested_s >= LEARN_AFTER_S && rested_s - dt_s < LEARN_AFTER_S;
    let leaves_quiet = departs && rested_s < LEARN_AFTER_S && state.feedback.error.quiet;
    // the gains of a described machine were identified together with its effects
    if !(just_settled || leaves_quiet) || config.feedforward.is_some() || state.feedback.sways {
        return;
    }
    let bend = observed.settled;
    let bellow_mm = config.geometry.lengths(&Shape {
        bend: Bend(bend),
        length: Mm(state.setpoint.length.at.x),
    });
    let lines = &mut state.transmission;
    let Sides { side, .. } = lines.pushes;
    let pose = HeldPose {
        bend,
        piston_mm: lines.pushes.piston_mm(),
        play_output_mm: lines.play_output_mm,
        bellow_mm,
        side,
        weight: lines.pushes.weight(),
    };
    let learned = state
        .learning
        .refine
        .learn(&config.refine, &lines.lines, &pose);
    if let Some(next) = learned {
        // bumpless: the pistons stay, so the same play outputs now mean another bend
        let before = lines.lines;
        let shift = lines.exchange(&config.geometry, &next);
        let outer = &mut state.feedback;
        let learned = outer.error.at(&bend);
        outer.error.change_lines(&before, &next);
        outer.pi.hand_over(shift + learned - outer.error.at(&bend));
        state.shift_model(shift);
    }
}

/// Steps the monitor for a controller that has reached its limits away from the target.
pub(super) fn monitor_saturation(
    config: &LoopConfig,
    state: &mut LoopState,
    estimate: Bend,
    moving: bool,
    cut: Cut,
    dt_s: f64,
) {
    let Some(f) = &config.feedback else { return };
    let outer = &mut state.feedback;
    let off = !outer.standstill.closed
        && (state.setpoint.target.bend.0 - estimate.0).norm()
            > f.obstruction.error_deg.to_radians();
    outer
        .saturation
        .step(moving, off, outer.integral_full, cut, dt_s);
}
