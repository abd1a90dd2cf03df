//! The deciding half of the tick: set-point, belief and rule, down to the pistons.

use super::crossing::{self, CROSSING_MIN_S, Passing};
use super::state::{Hold, LoopState};
use super::types::{FeedbackConfig, Input, LoopConfig};
use crate::control::follow::Follower;
use crate::control::inverse::{self, Choice};
use crate::control::limits::Cut;
use crate::control::observer::laws::{ROTATION, bend_of};
use crate::control::obstruction::Push;
use crate::control::rule::{self, Rule};
use crate::model::{Bend, Shape};
use crate::primitives::Steps;
use nalgebra::{Vector2, Vector3};

/// Share of the pace by which the lead may raise the speed of the command: pistons that follow the pace have that much to
/// spare.
const LEAD_SHARE: f64 = 0.35;
/// Longest time between two targets of a stream, s; a target that has lasted for longer is at rest.
const STREAM_PERIOD_S: f64 = 0.1;
/// Lag from which a line is slow: twice the time for which a reversal stops the tip, s.
const SLOW_S: f64 = 2.0 * CROSSING_MIN_S;
/// Time constant with which the offset after a hold decays, s.
const EASE_S: f64 = 0.15;
/// Time beyond lag, dead time and their error within which a free tip answers, s.
const ANSWERED_S: f64 = 0.1;

/// Decides whether the pistons must stand: in closed loop without a usable sensor. At the
/// beginning of a hold each piston stops within its braking distance; afterwards the targets start from where it stands.
pub(super) fn hold(config: &LoopConfig, state: &mut LoopState, steps: &Steps) -> bool {
    let must_hold = state.fusion.hold() && config.feedback.is_some();
    state.hold = match state.hold {
        Hold::Holding { stop_mm } if !must_hold => Hold::Leaving { stop_mm },
        Hold::Released { .. } | Hold::Leaving { .. } if must_hold => {
            state.setpoint.bend = Follower::resting(state.setpoint.bend.at);
            state.setpoint.length = Follower::resting(state.setpoint.length.at);
            // a target beyond the braking distance is given up; one within it is where the piston stops anyway
            let (at_mm, reach_mm) = (config.drive.piston_mm(steps), config.motion.braking_mm());
            let to_go_mm = state.targets_mm - at_mm;
            let stop_mm = at_mm + to_go_mm.map(|to_go| to_go.clamp(-reach_mm, reach_mm));
            Hold::Holding { stop_mm }
        }
        unchanged => unchanged,
    };
    must_hold
}

/// Moves the set-point towards the target, or onto the reference. Both stay within the range of the bellows.
pub(super) fn advance_setpoint(config: &LoopConfig, state: &mut LoopState, input: &Input) -> Cut {
    let mut pace = config.bend_pace;
    if config.feedback.is_some() {
        // the feedforward leads a slow line by τ r̈; a gentler start keeps that within the pace of the pistons
        let gentle = LEAD_SHARE * pace.speed / lead_s(config, state).max(1e-3);
        pace.acceleration = pace.acceleration.min(gentle);
    }
    match &input.reference {
        Some(reference) => state.setpoint.follow(config, reference, &pace, input.dt_s),
        None => state.setpoint.approach(config, &pace, input.dt_s),
    }
}

/// Time by which the feedforward leads the set-point, s.
fn lead_s(config: &LoopConfig, state: &LoopState) -> f64 {
    let lag_s = state.observer.dynamics.lag_s;
    config.feedback.map_or(0.0, |f| f.lead * lag_s)
}

/// What a decision commands, beside [`LoopState::targets_mm`].
#[derive(Default)]
pub(super) struct Decided {
    /// Bend of the channels, rad.
    pub(super) command: Bend,
    /// Bellow length changes of that bend, mm.
    pub(super) bellow_mm: Vector3<f64>,
    pub(super) cut: Cut,
}

/// What a decision depends on.
pub(super) struct Decision<'a> {
    pub(super) config: &'a LoopConfig,
    pub(super) state: &'a mut LoopState,
    /// Estimated bend, rad.
    pub(super) estimate: Vector2<f64>,
    /// Time since the last tick, s.
    pub(super) dt_s: f64,
}

impl Decision<'_> {
    /// Commands the pistons.
    pub(super) fn command(&mut self, moving: bool) -> Decided {
        let (config, dt_s) = (self.config, self.dt_s);
        let length_mm = self.state.setpoint.length.at.x;
        if config.feedback.is_some() && self.state.setpoint.acceleration.is_none() {
            // a path goes on from the sides on which the pistons push
            self.state.push_sides();
        }
        let command = match &config.feedback {
            None => self.open_loop(),
            Some(f) if moving => self.track(f),
            // what the base has done is not corrected
            Some(_) if self.state.base.moved => self.state.setpoint.bend.at + self.state.feedback,
            Some(f) => self.correct(f),
        };
        let stop_mm = match self.state.hold {
            Hold::Holding { stop_mm } => Some(stop_mm),
            _ => None,
        };
        let (allowed_mm, cut) = self.allowed(stop_mm.unwrap_or(self.state.rule.aim_mm));
        let state = &mut *self.state;
        state.rule.goal_mm = allowed_mm;
        let rests = !moving && !state.obstruction.blocked && state.periodic.hertz().is_none();
        state.targets_mm = match &config.feedback {
            _ if stop_mm.is_some() => allowed_mm,
            Some(f) if rests => {
                let error_rad = (state.setpoint.target.bend.0 - self.estimate).norm();
                let (rule, observer) = (&state.rule, &state.observer);
                let slow_mm = rule.slowly(&f.calm, observer, &state.targets_mm, error_rad, dt_s);
                ease(&mut state.hold, slow_mm, dt_s)
            }
            _ => ease(&mut state.hold, allowed_mm, dt_s),
        };
        Decided {
            command: Bend(command),
            bellow_mm: config.geometry.lengths(&Shape::new(command, length_mm)),
            cut,
        }
    }

    /// The paper's open loop: Eq. 16 for the set-point, through a described machine if there is one.
    fn open_loop(&mut self) -> Vector2<f64> {
        let (config, state, dt_s) = (self.config, &mut *self.state, self.dt_s);
        let wanted_mm = config.geometry.lengths(&state.setpoint.shape());
        let (limits, lines) = (&config.limits, &state.lines);
        let bellow_mm = match &mut state.described {
            Some(described) => described.invert(&wanted_mm, &limits.room(lines)),
            None => wanted_mm.add_scalar(limits.relief(&wanted_mm, lines)),
        };
        let piston_mm = Vector3::from_fn(|i, _| {
            let (line, side) = (&state.lines[i], state.sides[i]);
            let (piston_mm, next) = config.side.invert(line, side, bellow_mm[i], dt_s);
            state.sides[i] = next;
            piston_mm
        });
        self.aim(piston_mm);
        self.state.setpoint.bend.at
    }

    /// What the feedforward adds to the set-point, rad. Beyond a target at rest it would have to come back, and a reversal
    /// crosses the backlash: there it ends at the target, unless the line is so slow that the tip gains more by the lead than
    /// it loses by the reversal.
    fn ahead(&self, lead_s: f64) -> Vector2<f64> {
        let setpoint = &self.state.setpoint;
        let ahead = setpoint.bend.velocity * lead_s;
        let to_go = (setpoint.target.bend.0 - setpoint.bend.at).norm();
        if setpoint.target_rests_s > STREAM_PERIOD_S && ahead.norm() > to_go && lead_s < SLOW_S {
            ahead.cap_magnitude(to_go)
        } else {
            ahead
        }
    }

    /// The set-point moves: the pistons make the bend by which the tip is there once the lag has passed.
    fn track(&mut self, f: &FeedbackConfig) -> Vector2<f64> {
        let lead_s = lead_s(self.config, self.state);
        let at = self.state.setpoint.bend.at + self.ahead(lead_s);
        let observer = &self.state.observer;
        // g belongs to where the tip is; at the end of the motion less of it is left
        let to_go = (at - observer.settled_by_laws() - observer.residual()).norm();
        let share = (-to_go / f.observer.residual_path_deg.to_radians()).exp();
        let bend = rule::needed(observer, &at, share, &self.state.disturbed());
        let bend = self.bounded(f, &at, &bend);
        self.state.feedback = bend - self.state.setpoint.bend.at;
        let nominal = self.through_machine(&bend);
        let setpoint = &self.state.setpoint;
        match setpoint.bellow_motion(&self.config.geometry, lead_s) {
            Some(motion) => self.pass(&nominal, &motion),
            None => self.go(f, &nominal, None),
        }
        bend
    }

    /// The bend of the nominal channels at which a described machine bends by `bend`, less what was learned beside its laws, rad.
    fn through_machine(&mut self, bend: &Vector2<f64>) -> Vector2<f64> {
        let (geometry, state) = (&self.config.geometry, &mut *self.state);
        let Some(described) = &mut state.described else {
            return *bend;
        };
        let observer = &state.observer;
        let learned = bend_of(&observer.now.outputs(&observer.theta())) - observer.now.nominal();
        let length_mm = state.setpoint.length.at.x + state.rule.free * geometry.r_mm;
        let wanted_mm = geometry.lengths(&Shape::new(bend - learned, length_mm));
        let play_output_mm = described.play_outputs(&wanted_mm);
        let v = std::array::from_fn(|i| play_output_mm[i] / observer.mm_per_rad(i));
        bend_of(&v) + learned
    }

    /// The set-point rests: moves if the rule says so.
    fn correct(&mut self, f: &FeedbackConfig) -> Vector2<f64> {
        let foreseen = self.foresee();
        let (believed, channels) = (foreseen.believed, foreseen.channels);
        let theta = self.state.observer.theta();
        let error = self.state.setpoint.target.bend.0 - believed - self.state.disturbed();
        let bend = channels + rule::unrotated(error * f.kp, theta[ROTATION]);
        let at = self.state.setpoint.bend.at;
        let bend = self.bounded(f, &at, &bend);
        let state = &mut *self.state;
        let change = bend - channels;
        let risk = inverse::risk(&state.observer, &change, f.free_length_mm);
        let (dynamics, disturbed) = (state.observer.dynamics, state.periodic.hertz().is_some());
        state
            .rule
            .answer(&dynamics, &self.estimate, disturbed, self.dt_s);
        let step = f.step_deg.to_radians();
        let worth = |rule: &Rule, gain_2: f64| rule.moves(&dynamics, gain_2, risk, step, f.caution);
        if state.hold.is_holding() || !worth(&state.rule, change.norm_squared()) {
            return channels;
        }
        let stays = state.rule;
        // a described machine is believed anew in the next tick: the slope of its laws need not be known
        self.go(f, &(foreseen.nominal + change), Some(stays.free));
        let (allowed_mm, cut) = self.allowed(self.state.rule.aim_mm);
        let state = &mut *self.state;
        if cut != Cut::None {
            let left = error - (state.observer.at(&allowed_mm).0 - believed);
            if !worth(&stays, error.norm_squared() - left.norm_squared()) {
                state.rule = stays;
                return channels;
            }
        }
        state.feedback = bend - at;
        state.rule.act(&state.setpoint.target.bend.0);
        bend
    }

    /// Pistons within the limits of the actuators.
    fn allowed(&self, piston_mm: Vector3<f64>) -> (Vector3<f64>, Cut) {
        let shape = Shape::new(self.estimate, self.state.setpoint.length.at.x);
        let estimated_mm = self.config.geometry.lengths(&shape);
        self.config.limits.pistons(&piston_mm, &estimated_mm)
    }

    fn foresee(&mut self) -> Foreseen {
        let (observer, goal_mm) = (&self.state.observer, &self.state.rule.goal_mm);
        let theta = observer.theta();
        let Some(described) = &mut self.state.described else {
            let (believed, there) = observer.at(goal_mm);
            let channels = bend_of(&there.outputs(&theta));
            return Foreseen {
                believed,
                channels,
                nominal: channels,
            };
        };
        let (by_nominal, there) = observer.at(&described.pistons_at(goal_mm));
        let bend = described.foresee(&there.play_outputs_mm()).bend.0;
        let nominal = bend_of(&there.outputs(&theta));
        let beside = bend - there.nominal();
        Foreseen {
            believed: by_nominal + bend
                - (observer.modelled + there.nominal() - observer.now.nominal()),
            channels: nominal + beside,
            nominal,
        }
    }

    /// The bend of the channels, no further from `at` than the bound of the correction, nor from the estimate than an obstruction
    /// permits.
    fn bounded(
        &mut self,
        f: &FeedbackConfig,
        at: &Vector2<f64>,
        bend: &Vector2<f64>,
    ) -> Vector2<f64> {
        let (most, correction) = (f.integral_max_deg.to_radians(), bend - at);
        self.state.feedback_full = correction.norm() > most;
        let bend = at + correction.cap_magnitude(most);
        if !self.state.obstruction.blocked {
            return bend;
        }
        let stiffness = self.state.lines.iter().map(|l| 1.0 + l.k_epsilon);
        let stiffest = stiffness.fold(1.0, f64::max);
        let (limits, geometry) = (&self.config.limits, &self.config.geometry);
        let kpa_per_rad = limits.pressure_kpa_per_mm * stiffest * geometry.r_mm;
        let press = f.obstruction.press_kpa / kpa_per_rad;
        self.estimate + (bend - self.estimate).cap_magnitude(press)
    }

    /// Chooses sides and common length for a bend of the channels, and aims the pistons there. `keep` is the free common length
    /// that a correction keeps.
    fn go(&mut self, f: &FeedbackConfig, bend: &Vector2<f64>, keep: Option<f64>) {
        let (_, aim_mm) = self.choose([0.0, f.free_length_mm], bend, keep);
        self.aim(aim_mm);
    }

    /// Aims the pistons, as counted.
    fn aim(&mut self, piston_mm: Vector3<f64>) {
        self.state.rule.aim_mm = match &mut self.state.described {
            Some(described) => described.counted(&piston_mm),
            None => piston_mm,
        };
    }

    /// Chooses sides and common length for a bend of the channels, and the pistons there, mm. Beside the commanded length and `free`, rad,
    /// `spare_mm` may be spent.
    fn choose(
        &mut self,
        [free, spare_mm]: [f64; 2],
        bend: &Vector2<f64>,
        keep: Option<f64>,
    ) -> (Choice, Vector3<f64>) {
        let (config, state) = (self.config, &mut *self.state);
        let theta = state.observer.theta();
        let (_, there) = state.observer.at(&state.rule.goal_mm);
        let longer_mm = state.setpoint.length.at.x - config.geometry.rest_length_mm;
        let commanded = longer_mm / config.geometry.r_mm;
        let from = inverse::From {
            observer: &state.observer,
            limits: &config.limits,
            there: &there,
            theta: &theta,
            estimate: &self.estimate,
            keep: keep.map(|free| commanded + free),
            length: commanded + free,
            free_mm: spare_mm,
        };
        let choice = inverse::choose(&from, bend);
        let aim_mm = inverse::pistons(&from, &choice, &state.rule.aim_mm);
        state.rule.free = choice.length - commanded;
        (choice, aim_mm)
    }

    /// A moving reference: the pistons pass where the set-point is, and cross their backlash where the reference turns. The free common
    /// length stays as it was.
    fn pass(&mut self, bend: &Vector2<f64>, motion: &[Vector3<f64>; 2]) {
        let (choice, _) = self.choose([self.state.rule.free, 0.0], bend, None);
        let (config, state, dt_s) = (self.config, &mut *self.state, self.dt_s);
        let (observer, limits) = (&state.observer, &config.motion.limits);
        let theta = observer.theta();
        let piston_mm = Vector3::from_fn(|i, _| {
            let factor = observer.mm_per_rad(i) / config.geometry.r_mm;
            let passing = Passing {
                w_mm: observer.now.solve(i, choice.outputs[i], &theta) * observer.mm_per_rad(i),
                speed: motion[0][i] * factor,
                acceleration: motion[1][i] * factor,
            };
            let half_width_mm = observer.lines[i].k_lambda_mm;
            let before = state.sides[i];
            let (piston_mm, next) = crossing::invert(half_width_mm, before, &passing, limits, dt_s);
            state.sides[i] = next;
            piston_mm
        });
        self.aim(piston_mm);
    }

    /// Notes whether the tip is obstructed, and whether the controller has reached its limits away from the target.
    pub(super) fn watch(&mut self, moving: bool, cut: Cut) {
        let (state, estimate, dt_s) = (&mut *self.state, self.estimate, self.dt_s);
        let Some(f) = &self.config.feedback else {
            return;
        };
        state.rule.step(moving, dt_s);
        let error = state.setpoint.target.bend.0 - estimate;
        let was_blocked = state.obstruction.blocked;
        let response_s = state.observer.dynamics.response_s();
        let answer_s = response_s + state.dynamics.error_max_s() + ANSWERED_S;
        let push = Push {
            given: state.observer.modelled,
            estimate,
            error,
        };
        let obstruction = &mut state.obstruction;
        obstruction.step(&f.obstruction, moving, &push, answer_s, dt_s);
        if obstruction.blocked && !was_blocked {
            // what was learned against the obstruction says nothing about the tip
            state.return_to_known(&estimate, f64::INFINITY);
        }
        let off = error.norm() > f.obstruction.error_deg.to_radians();
        let full = state.feedback_full;
        state.saturation.step(moving, off, full, cut, dt_s);
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

/// What the pistons cause once they are where they go, rad.
struct Foreseen {
    /// The bend of the tip.
    believed: Vector2<f64>,
    /// The bend of the channels, and of the nominal channels if a described machine bends by others.
    channels: Vector2<f64>,
    nominal: Vector2<f64>,
}
