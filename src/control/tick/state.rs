//! State of the loop from tick to tick.

use super::setpoint::SetPoint;
use super::types::LoopConfig;
use crate::control::dynamics::{DynamicsPrior, DynamicsRange};
use crate::control::feedforward::Feedforward;
use crate::control::observer::bank::DynamicsBank;
use crate::control::observer::{Knowledge, Observer, Periodic};
use crate::control::obstruction::ObstructionDetector;
use crate::control::path::RUN_UP_S;
use crate::control::rule::Rule;
use crate::control::saturation::SaturationMonitor;
use crate::estimation::fusion::base_watch::Watch;
use crate::estimation::fusion::sway;
use crate::estimation::fusion::tip::Fusion;
use crate::model::{Bend, Line, Shape, SideState};
use crate::primitives::{SURE_SIGMAS, Steps};
use nalgebra::{Vector2, Vector3};

/// Time by which the pistons answer a command, s.
const PISTONS_S: f64 = 0.025;
/// Time for which the pistons of a restart count as having stood, s.
const SETTLED_S: f64 = 10.0;

/// State of the loop.
#[derive(Debug, Clone)]
pub struct LoopState {
    /// Orientation estimation.
    pub fusion: Fusion,
    pub(super) motors: MotorActivity,
    pub(super) setpoint: SetPoint,
    /// Gains as published: those of the calibration, refined.
    pub(super) lines: [Line; 3],
    /// Largest |v| that each channel has shown, rad.
    pub(super) shown: [f64; 3],
    /// Sides of the backlash as an open loop or a path has commanded them.
    pub(super) sides: [SideState; 3],
    pub(super) observer: Observer,
    /// Lag and dead time that are plausible, their bank, and what was known before any motion that it has seen.
    pub(super) dynamics: DynamicsRange,
    pub(super) bank: DynamicsBank,
    pub(super) before: DynamicsPrior,
    /// What to return to when the base moves.
    pub(super) before_base: BeforeBaseMotion,
    /// What was known when the set-point left the last pose that nothing obstructed.
    pub(super) known: Known,
    /// The published gains when the set-point last left a pose that nothing obstructed and no line was suspected, and the bend by them as
    /// the tip shows it now, rad.
    pub(super) accepted: [Line; 3],
    pub(super) shown_by_accepted: Vector2<f64>,
    pub(super) periodic: Periodic,
    /// Sum of what the tip moved otherwise than predicted, and the last estimate, rad.
    pub(super) unexplained: Vector2<f64>,
    pub(super) last_estimate: Vector2<f64>,
    pub(super) rule: Rule,
    /// The set-point moves.
    pub(super) moving: bool,
    /// Part of the command beyond the set-point, rad, and whether it is at its bound.
    pub(super) feedback: Vector2<f64>,
    pub(super) feedback_full: bool,
    pub(super) obstruction: ObstructionDetector,
    pub(super) saturation: SaturationMonitor,
    /// The feedforward through a described machine, if there is one.
    pub(super) described: Option<Feedforward>,
    pub(super) base: BaseState,
    pub(super) hold: Hold,
    /// Piston targets of the last tick, mm.
    pub(super) targets_mm: Vector3<f64>,
}

/// What an obstruction must not teach.
#[derive(Debug, Clone)]
pub(super) struct Known {
    laws: Knowledge,
    dynamics: DynamicsRange,
    bank: DynamicsBank,
}

/// Laws of before a motion of the base that is not noticed yet can have begun.
#[derive(Debug, Clone)]
pub(super) struct BeforeBaseMotion {
    /// At least, and at most, [`UNNOTICED_S`] ago.
    pub(super) laws: [Knowledge; 2],
    age_s: f64,
    /// The base sways.
    sways: bool,
    /// Standard deviation that a sway gives the measured bend, rad.
    pub(super) sway_rad: f64,
}

/// Time within which a motion of the base is noticed, s: twice the memory of a sway.
const UNNOTICED_S: f64 = 2.0 * sway::MEMORY_S;

impl BeforeBaseMotion {
    fn of(laws: Knowledge) -> Self {
        Self {
            laws: [laws; 2],
            age_s: 0.0,
            sways: false,
            sway_rad: 0.0,
        }
    }
}

/// Activity of the motors.
#[derive(Debug, Clone)]
pub(super) struct MotorActivity {
    pub(super) last_steps: Steps,
    /// Time since the last step of each motor, s.
    pub(super) idle_s: [f64; 3],
    /// Time since the last step of any motor, s.
    pub(super) still_s: f64,
}

/// Supervision of the base.
#[derive(Debug, Clone, Default)]
pub(super) struct BaseState {
    pub(super) watch: Watch,
    pub(super) quiet: QuietPose,
    /// The base has turned since the alignment.
    pub(super) moved: bool,
}

/// The last pose in which nothing moved, rad.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct QuietPose {
    pub(super) estimate: Vector2<f64>,
    /// Bend from the play outputs.
    pub(super) played: Vector2<f64>,
}

/// Whether the pistons must stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Hold {
    /// The pistons follow their targets, plus an offset that decays after a hold.
    Released { offset_mm: Vector3<f64> },
    /// Each piston stops at this position and stands there.
    Holding { stop_mm: Vector3<f64> },
    /// The first tick after a hold.
    Leaving { stop_mm: Vector3<f64> },
}

impl Hold {
    pub(super) const RELEASED: Self = Self::Released {
        offset_mm: Vector3::new(0.0, 0.0, 0.0),
    };

    pub(super) fn is_holding(&self) -> bool {
        matches!(self, Self::Holding { .. })
    }
}

impl LoopState {
    /// Straight and at rest with the pistons at zero, not aligned.
    pub fn new(config: &LoopConfig) -> Self {
        let dynamics = config.dynamics.range();
        let observer = observer(config, config.lines, &dynamics);
        Self {
            fusion: Fusion::default(),
            motors: MotorActivity {
                last_steps: Steps::default(),
                idle_s: [f64::INFINITY; 3],
                still_s: 0.0,
            },
            setpoint: SetPoint::resting(Shape::new(
                Vector2::zeros(),
                config.geometry.rest_length_mm,
            )),
            lines: config.lines,
            shown: [0.0; 3],
            sides: Default::default(),
            accepted: config.lines,
            shown_by_accepted: Vector2::zeros(),
            before_base: BeforeBaseMotion::of(observer.known),
            known: Known {
                laws: observer.known,
                dynamics,
                bank: DynamicsBank::default(),
            },
            observer,
            dynamics,
            bank: DynamicsBank::default(),
            before: config.dynamics,
            periodic: Periodic::new(&config.feedback.unwrap_or_default().periodic),
            unexplained: Vector2::zeros(),
            last_estimate: Vector2::zeros(),
            rule: Rule::default(),
            moving: false,
            feedback: Vector2::zeros(),
            feedback_full: false,
            obstruction: ObstructionDetector::default(),
            saturation: SaturationMonitor::default(),
            described: config.feedforward.clone().map(Feedforward::new),
            base: BaseState::default(),
            hold: Hold::RELEASED,
            targets_mm: Vector3::zeros(),
        }
    }

    /// Time from the command of a tick until the tip answers it, without the lag, which the feedforward leads, s.
    pub fn answers_after_s(&self, config: &LoopConfig, dt_s: f64) -> f64 {
        self.observer.dynamics.delay_s + config.motion.lead_s.max(dt_s)
    }

    /// Time from an order until the tip begins a path that is known in advance, s: its pistons cross their backlash first.
    pub fn begins_after_s(&self, config: &LoopConfig) -> f64 {
        RUN_UP_S + self.answers_after_s(config, 0.0)
    }

    /// Transmission gains in use.
    pub fn lines(&self) -> &[Line; 3] {
        &self.lines
    }

    /// Standard deviations of the refined k_ε and k_λ in mm, per channel.
    pub fn line_sigmas(&self) -> [[f64; 2]; 3] {
        std::array::from_fn(|i| {
            let k_epsilon = (1.0 + self.lines[i].k_epsilon) * self.observer.gain_sigma(i);
            [k_epsilon, self.observer.half_width_sigma_mm(i)]
        })
    }

    /// Replaces the transmission gains after a calibration. A described machine keeps its own, which belong to its effects.
    pub fn set_lines(&mut self, config: &LoopConfig, lines: [Line; 3]) {
        if self.described.is_none() {
            self.lines = lines;
            self.observer = observer(config, lines, &self.dynamics);
            self.begin();
        }
    }

    /// Bend that the counted steps cause by the accepted gains or, where a machine is described, by its laws, rad.
    pub(super) fn played(&self) -> Vector2<f64> {
        match self.described {
            Some(_) => self.observer.modelled,
            None => self.observer.played_by(&self.accepted)[0],
        }
    }

    /// By what the tip will be bent without the pistons when they have answered a command of now, rad. Of what repeats, a base that sways
    /// may be the cause; that share is not for the pistons to cancel.
    pub(super) fn disturbed(&self) -> Vector2<f64> {
        let dynamics = &self.observer.dynamics;
        let (bend, rate) = self.periodic.at(dynamics.delay_s + PISTONS_S);
        (bend + rate * dynamics.lag_s) * self.base.watch.sway.share_of_tip()
    }

    /// Takes the published gains as what the lines are, each as far as the poses say more than the spread that the calibration states.
    pub(super) fn accept_lines(&mut self, config: &LoopConfig) {
        for i in 0..3 {
            let (from, to) = (config.lines[i], self.lines[i]);
            let spread = config.line_sigmas[i][0] / (1.0 + from.k_epsilon);
            let [spread_2, found_2] = [spread, self.observer.gain_sigma(i)].map(|s| s * s);
            let known = spread_2 / (spread_2 + found_2).max(f64::MIN_POSITIVE);
            self.accepted[i] = Line {
                k_epsilon: from.k_epsilon + known * (to.k_epsilon - from.k_epsilon),
                ..to
            };
        }
    }

    /// Takes the sides on which the pistons push by the plays.
    pub(super) fn push_sides(&mut self) {
        self.sides = std::array::from_fn(|i| {
            let play = &self.observer.now.play[i];
            SideState {
                w_mm: play.w_mm,
                side: -play.slope,
                direction: -play.slope,
            }
        });
    }

    /// Remembers what is known, to return to.
    pub(super) fn remember(&mut self) {
        self.known = Known {
            laws: self.observer.known,
            dynamics: self.dynamics,
            bank: self.bank.clone(),
        };
    }

    /// What is known now is all there is to return to.
    fn begin(&mut self) {
        self.remember();
        self.before_base = BeforeBaseMotion::of(self.observer.known);
    }

    /// Asks the watch whether the base sways. Once it does, takes back what was learned while that was not noticed.
    pub(super) fn attribute_to_base(&mut self, dt_s: f64) {
        let sway = &self.base.watch.sway;
        let before = &mut self.before_base;
        let sway_rad = sway.mean_square().sqrt();
        let sways = sway.sways() && sway_rad > 0.0;
        let began = !std::mem::replace(&mut before.sways, sways) && sways;
        before.sway_rad = 0.0;
        if sway_rad == 0.0 {
            before.age_s += dt_s;
            if before.age_s > UNNOTICED_S {
                (before.laws, before.age_s) = ([before.laws[1], self.observer.known], 0.0);
            }
        } else if before.sways {
            // a sway is no noise but has the same sign for seconds
            before.sway_rad = SURE_SIGMAS * sway_rad;
            if began {
                let by_laws = self.observer.settled_by_laws();
                self.unlearn(&by_laws, 0.0);
            }
        }
    }

    /// Returns to the laws of before the base can have begun to move; the tip, once settled, bends by `bend`, rad, see
    /// [`Observer::believe`].
    pub(super) fn unlearn(&mut self, bend: &Vector2<f64>, sigmas: f64) {
        let before = &mut self.before_base;
        (before.laws[1], before.age_s) = (before.laws[0], 0.0);
        self.observer.known = before.laws[0];
        self.observer.believe(bend, sigmas);
    }

    /// Returns to what was remembered; the tip, once settled, bends by `bend`, rad, see [`Observer::believe`].
    pub(super) fn return_to_known(&mut self, bend: &Vector2<f64>, sigmas: f64) {
        self.observer.known = self.known.laws;
        self.observer.believe(bend, sigmas);
        (self.dynamics, self.bank) = (self.known.dynamics, self.known.bank.clone());
        self.observer.take_dynamics(&self.dynamics, false);
    }

    /// The pistons rest at these counts and the tip shall stay at `at`. What the laws say otherwise becomes the residual, so that
    /// nothing moves.
    pub fn stand(&mut self, config: &LoopConfig, steps: &Steps, at: Bend) {
        let piston_mm = config.drive.piston_mm(steps);
        let rest_length_mm = config.geometry.rest_length_mm;
        let play_output_mm = self.observer.play_outputs(&piston_mm);
        let bellow_mm = Vector3::from_fn(|i, _| self.lines[i].bellow_mm(play_output_mm[i]));
        let mut length_mm = rest_length_mm + bellow_mm.sum() / 3.0;
        let mut modelled = None;
        if let Some(machine) = config.feedforward.clone() {
            let described = self.described.insert(Feedforward::new(machine));
            let shape = described.advance(&play_output_mm, SETTLED_S);
            (modelled, length_mm) = (Some(shape.bend.0), shape.length.0);
        }
        // within its plays and the free length, a tip at its rest length has that length
        let f = config.feedback.unwrap_or_default();
        let plays_mm = self.lines.map(|line| line.bellow_mm(line.k_lambda_mm));
        let free_mm = f.free_length_mm + plays_mm.iter().sum::<f64>() / 3.0;
        if (length_mm - rest_length_mm).abs() <= free_mm {
            length_mm = rest_length_mm;
        }
        let possible_mm = length_mm.clamp(0.5 * rest_length_mm, 2.0 * rest_length_mm);
        self.setpoint = SetPoint::resting(Shape::new(at.0, possible_mm));
        self.observer
            .stand(&f.observer, &piston_mm, modelled, &at.0);
        self.begin();
        self.accept_lines(config);
        self.shown_by_accepted = self.played();
        self.push_sides();
        self.rule = Rule::resting(piston_mm);
        // what the estimate did meanwhile is no disturbance
        self.periodic = Periodic::new(&f.periodic);
        (self.unexplained, self.last_estimate) = (Vector2::zeros(), at.0);
        (self.feedback, self.feedback_full, self.moving) = (Vector2::zeros(), false, false);
        self.obstruction = ObstructionDetector::default();
        self.saturation = SaturationMonitor::default();
        self.hold = Hold::RELEASED;
        self.targets_mm = piston_mm;
        self.motors.last_steps = *steps;
    }

    /// Removes what was learned from the command, for an open loop.
    pub fn forget_feedback(&mut self) {
        self.observer.forget();
        self.begin();
        (self.feedback, self.feedback_full) = (Vector2::zeros(), false);
        self.saturation = SaturationMonitor::default();
    }
}

/// The observer of these lines. A described machine keeps its gains, which were identified together with its effects.
fn observer(config: &LoopConfig, lines: [Line; 3], dynamics: &DynamicsRange) -> Observer {
    let f = config.feedback.unwrap_or_default();
    let learns = config.refine.enabled && config.feedforward.is_none();
    let sigmas = learns.then_some(config.line_sigmas);
    Observer::new(&f.observer, &config.geometry, lines, sigmas, dynamics)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Board, Calibration, Gains, assemble, source};
    use crate::estimation::fusion::base_watch::WatchInput;
    use nalgebra::Vector3;

    #[test]
    fn what_was_learned_in_a_sway_is_taken_back_however_it_begins() {
        let board: Board =
            source::parse("sim.toml", include_str!("../../../boards/sim.toml")).unwrap();
        let calib: Calibration =
            source::parse("paper.toml", include_str!("../../../calib/paper.toml")).unwrap();
        let config = assemble(&board, &calib, &Gains::default());
        let dt_s = 0.005;
        for (first_deg, then_deg) in [(1.2f64, 8.0f64), (8.0, 8.0), (3.0, 6.0)] {
            let mut state = LoopState::new(&config);
            let mut learned = state.observer.learned();
            let known = learned[0];
            learned[0][0] += 0.1;
            state.observer.assume(&learned);
            let mut small = false;
            for k in 0..20 * 200 {
                let t = f64::from(k) * dt_s;
                let size_deg = if t < 8.0 { first_deg } else { then_deg };
                let rate = size_deg.to_radians() * (0.3 * std::f64::consts::TAU * t).sin();
                let input = WatchInput {
                    rate_rad_s: Vector3::z() * rate,
                    estimate: Vector2::new(0.5, 0.0),
                    model: Vector2::new(0.5, 0.0),
                    setpoint: Vector2::new(0.5, 0.0),
                    remaining: Vector2::zeros(),
                    still_s: 1.0,
                    response_s: 0.04,
                    turn_variance: 0.0,
                    dt_s,
                };
                let watch = &mut state.base.watch;
                watch.step(&config.fuse.watch, &input, || 0.0);
                small |= watch.sway.sways() && watch.sway.mean_square() == 0.0;
                state.attribute_to_base(dt_s);
            }
            assert!(state.before_base.sway_rad > 0.0, "{first_deg}°");
            assert!(small || first_deg > 2.0, "{first_deg}°");
            assert_eq!(state.observer.learned()[0], known, "{first_deg}°");
        }
    }
}
