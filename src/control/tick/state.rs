//! State of the loop from tick to tick.

use super::types::LoopConfig;
use crate::control::backlash_adaptation::BacklashAdaptation;
use crate::control::feedforward::FeedforwardState;
use crate::control::follow::{Follower, Pace};
use crate::control::hunting::HuntingDetector;
use crate::control::learning::dynamics::DynamicsBank;
use crate::control::learning::online::RefineState;
use crate::control::learning::sides::Sides;
use crate::control::learning::static_error::StaticError;
use crate::control::obstruction::ObstructionDetector;
use crate::control::pi::{DynamicsPrior, DynamicsRange, PiState, ReferenceModel};
use crate::control::saturation::SaturationMonitor;
use crate::control::standstill::StandstillLatch;
use crate::estimation::fusion::base_watch::Watch;
use crate::estimation::fusion::tip::Fusion;
use crate::model::{Bend, Geometry, Line, Shape, SideState};
use crate::primitives::{Mm, Steps};
use nalgebra::{Vector1, Vector2, Vector3};

/// Time for which the pistons of a restart count as having stood, s.
const SETTLED_S: f64 = 10.0;

/// State of the loop.
#[derive(Debug, Clone)]
pub struct LoopState {
    /// Orientation estimation.
    pub fusion: Fusion,
    pub(super) motors: MotorActivity,
    pub(super) setpoint: SetPoint,
    pub(super) transmission: Transmission,
    /// Lag and dead time in use, and the plausible range.
    pub(super) dynamics: DynamicsRange,
    pub(super) feedback: Feedback,
    pub(super) learning: Learning,
    pub(super) base: BaseState,
    pub(super) hold: Hold,
    /// Piston targets of the last tick, mm.
    pub(super) targets_mm: Vector3<f64>,
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

/// Target and set-point: bend in rad, length in mm.
#[derive(Debug, Clone)]
pub(super) struct SetPoint {
    pub(super) target: Shape,
    /// Time since the last target, s.
    pub(super) target_rests_s: f64,
    pub(super) bend: Follower<2>,
    /// Acceleration of the reference that the set-point follows, rad/s²; `None` for a target.
    pub(super) acceleration: Option<Vector2<f64>>,
    /// Acceleration limit of the present motion, rad/s².
    brake: f64,
    pub(super) length: Follower<1>,
}

impl SetPoint {
    fn resting(at: Shape) -> Self {
        let length = Follower::resting(Vector1::new(at.length.0));
        Self { target: at, target_rests_s: f64::INFINITY, bend: Follower::resting(at.bend.0), acceleration: None, brake: 0.0, length }
    }

    /// `pace` with the acceleration of the present motion for as long as the bend is faster than `pace` permits or could not stop
    /// at the target with it: a target with a slower pace is not overshot.
    pub(super) fn brake(&mut self, pace: &Pace) -> Pace {
        let speed = self.bend.velocity.norm();
        let to_go = (self.target.bend.0 - self.bend.at).norm();
        if speed <= pace.speed && speed.powi(2) <= 2.0 * pace.acceleration * to_go {
            self.brake = pace.acceleration;
        }
        Pace { acceleration: self.brake.max(pace.acceleration), ..*pace }
    }

    pub(super) fn has_arrived(&self) -> bool {
        let stands = self.bend.velocity == Vector2::zeros();
        stands && self.bend.arrived(&self.target.bend.0) && self.length.arrived(&Vector1::new(self.target.length.0))
    }
}

/// The transmission lines.
#[derive(Debug, Clone, Default)]
pub(super) struct Transmission {
    pub(super) lines: [Line; 3],
    /// Sides of the backlash as the inverse has commanded them.
    pub(super) sides: [SideState; 3],
    /// Outputs of the play operators at the counted steps, mm.
    pub(super) play_output_mm: Vector3<f64>,
    /// Play outputs as the inverse intended them, mm.
    pub(super) intended_mm: Vector3<f64>,
    /// Sides of the backlash at the counted steps.
    pub(super) pushes: Sides,
    /// State of the effects, with a feedforward through a described machine.
    pub(super) described: Option<FeedforwardState>,
}

impl Transmission {
    /// Shape at the play outputs: bend in rad, length in mm.
    pub(super) fn played_shape(&self, geometry: &Geometry) -> Shape {
        shape_of(geometry, &self.lines, &self.play_output_mm)
    }

    /// Shape at the play outputs that the inverse intended.
    pub(super) fn intended_shape(&self, geometry: &Geometry) -> Shape {
        shape_of(geometry, &self.lines, &self.intended_mm)
    }

    /// Takes over that each k_λ is larger by ν r (1 + k_ε), within the bounds of the refinement. The pistons stay. Returns the change
    /// of the intended bend, rad.
    pub(super) fn widen(&mut self, config: &LoopConfig, nu: &Vector3<f64>) -> Vector2<f64> {
        let before = self.intended_shape(&config.geometry).bend.0;
        for (i, line) in self.lines.iter_mut().enumerate() {
            let now_mm = line.k_lambda_mm;
            let [_, [least, most]] = config.refine.bounds(&config.lines[i]);
            let wider_mm = now_mm + line.play_output_mm(nu[i] * config.geometry.r_mm);
            line.k_lambda_mm = wider_mm.clamp(least.min(now_mm), most.max(now_mm));
            let change_mm = (line.k_lambda_mm - now_mm) * self.sides[i].side;
            self.intended_mm[i] -= change_mm;
            self.sides[i].w_mm -= change_mm;
        }
        self.intended_shape(&config.geometry).bend.0 - before
    }
}

/// Shape at the play outputs `w_mm` with the gains `lines`.
pub(super) fn shape_of(geometry: &Geometry, lines: &[Line; 3], w_mm: &Vector3<f64>) -> Shape {
    geometry.shape(&Vector3::from_fn(|i, _| lines[i].bellow_mm(w_mm[i])))
}

/// The outer loop.
#[derive(Debug, Clone, Default)]
pub(super) struct Feedback {
    pub(super) model: ReferenceModel,
    pub(super) pi: PiState,
    /// What the poses have taught about the error of the model.
    pub(super) error: StaticError,
    /// Learned error at the set-point plus that of the controller, contained in the command, rad.
    pub(super) feedback: Vector2<f64>,
    /// Integral time in use, s.
    pub(super) integral_s: f64,
    /// The integrator is at its bound.
    pub(super) integral_full: bool,
    pub(super) standstill: StandstillLatch,
    /// Time since the latch closed, s.
    pub(super) standstill_s: f64,
    pub(super) obstruction: ObstructionDetector,
    pub(super) hunting: HuntingDetector,
    /// Controller and learned error when the set-point last left a pose that nothing obstructed.
    pub(super) free: (PiState, StaticError),
    /// The set-point moves.
    pub(super) moving: bool,
    pub(super) saturation: SaturationMonitor,
    pub(super) backlash: BacklashAdaptation,
}

/// The online learners.
#[derive(Debug, Clone)]
pub(super) struct Learning {
    pub(super) refine: RefineState,
    pub(super) bank: DynamicsBank,
    /// Lag and dead time before any motion that the bank has seen.
    pub(super) before: DynamicsPrior,
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
    pub(super) feedback: Vector2<f64>,
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
    pub(super) const RELEASED: Self = Self::Released { offset_mm: Vector3::new(0.0, 0.0, 0.0) };

    pub(super) fn is_holding(&self) -> bool {
        matches!(self, Self::Holding { .. })
    }
}

impl LoopState {
    /// Straight and at rest with the pistons at zero, not aligned.
    pub fn new(config: &LoopConfig) -> Self {
        Self {
            fusion: Fusion::default(),
            motors: MotorActivity { last_steps: Steps::default(), idle_s: [f64::INFINITY; 3], still_s: 0.0 },
            setpoint: SetPoint::resting(Shape { bend: Bend::STRAIGHT, length: Mm(config.geometry.rest_length_mm) }),
            transmission: Transmission {
                lines: config.lines,
                described: config.feedforward.as_deref().map(FeedforwardState::new),
                ..Transmission::default()
            },
            dynamics: config.dynamics.range(),
            feedback: Feedback::default(),
            learning: Learning {
                refine: RefineState::new(&config.refine, &config.line_priors()),
                bank: DynamicsBank::default(),
                before: config.dynamics,
            },
            base: BaseState::default(),
            hold: Hold::RELEASED,
            targets_mm: Vector3::zeros(),
        }
    }

    /// Time from the command of a tick until the tip answers it, without the lag, which the feedforward leads, s.
    pub fn answers_after_s(&self, config: &LoopConfig, dt_s: f64) -> f64 {
        self.dynamics.best.delay_s + config.motion.lead_s.max(dt_s)
    }

    /// Transmission gains in use.
    pub fn lines(&self) -> &[Line; 3] {
        &self.transmission.lines
    }

    /// Standard deviations of the refined k_ε and k_λ in mm, per channel.
    pub fn line_sigmas(&self) -> [[f64; 2]; 3] {
        self.learning.refine.sigma()
    }

    /// Replaces the transmission gains after a calibration. A described machine keeps its own, which belong to its effects.
    pub fn set_lines(&mut self, lines: [Line; 3]) {
        if self.transmission.described.is_none() {
            self.transmission.lines = lines;
            self.feedback.error = StaticError::default();
        }
    }

    /// The pistons rest at these counts and the tip shall stay at `at`. The difference to the bend from the pistons
    /// becomes the integral part, so that nothing moves.
    pub fn stand(&mut self, config: &LoopConfig, steps: &Steps, at: Bend) {
        let piston_mm = config.drive.piston_mm(steps);
        let lines = &mut self.transmission;
        lines.pushes = Sides::resting(piston_mm);
        for i in 0..3 {
            let line = &lines.lines[i];
            let w_mm = line.play(lines.play_output_mm[i], piston_mm[i]);
            let side = if line.k_lambda_mm > 0.0 { ((piston_mm[i] - w_mm) / line.k_lambda_mm).clamp(-1.0, 1.0) } else { 0.0 };
            lines.play_output_mm[i] = w_mm;
            lines.intended_mm[i] = w_mm;
            lines.sides[i] = SideState { w_mm, side, way: if side == 0.0 { 0.0 } else { side.signum() } };
        }
        let mut given = lines.intended_shape(&config.geometry);
        if let Some(machine) = config.feedforward.as_deref() {
            let mut described = FeedforwardState::new(machine);
            given = described.advance(machine, &lines.intended_mm, SETTLED_S);
            lines.described = Some(described);
        }
        let length = given.length.0.clamp(0.5 * config.geometry.rest_length_mm, 2.0 * config.geometry.rest_length_mm);
        self.setpoint = SetPoint::resting(Shape { bend: at, length: Mm(length) });
        let feedback = given.bend.0 - at.0;
        let (error, integral) = (self.feedback.error, feedback - self.feedback.error.at(&at.0));
        let pi = PiState { integral, feedback: integral };
        let mut backlash = self.feedback.backlash;
        backlash.forget();
        self.feedback = Feedback {
            model: ReferenceModel::resting(given.bend.0),
            pi,
            error,
            free: (pi, error),
            feedback,
            backlash,
            hunting: HuntingDetector::new(self.feedback.hunting.caution),
            ..Feedback::default()
        };
        self.hold = Hold::RELEASED;
        self.targets_mm = piston_mm;
        self.motors.last_steps = *steps;
    }

    /// Removes the feedback and what was learned from the command, for an open loop.
    pub fn forget_feedback(&mut self) {
        self.feedback.pi = PiState::default();
        self.feedback.error = StaticError::default();
        self.feedback.feedback = Vector2::zeros();
        self.feedback.integral_full = false;
        self.feedback.saturation = SaturationMonitor::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The target stays and its pace falls to `share` after `change_s`: neither sooner nor later may the set-point pass it.
    #[test]
    fn a_slower_pace_in_mid_motion_does_not_overshoot() {
        let dt_s = 1.0 / 200.0;
        for share in [0.5, 0.1, 0.01, 0.001] {
            for change_s in [0.05, 0.2, 0.4, 0.6, 0.7] {
                let fast = Pace { speed: 1.5, acceleration: 10.0 };
                let slow = Pace { speed: fast.speed * share, acceleration: fast.acceleration * share };
                let mut setpoint = SetPoint::resting(Shape { bend: Bend::STRAIGHT, length: Mm(10.0) });
                setpoint.target.bend = Bend(Vector2::new(1.0, 0.0));
                let mut furthest: f64 = 0.0;
                for k in 0..1600 {
                    let pace = setpoint.brake(if f64::from(k) * dt_s < change_s { &fast } else { &slow });
                    setpoint.bend.step(&setpoint.target.bend.0, &pace, dt_s);
                    furthest = furthest.max(setpoint.bend.at.x);
                }
                assert!(furthest <= 1.0 + 1e-3, "{share} after {change_s} s: {furthest}");
                assert!(setpoint.bend.velocity.norm() <= slow.speed + 1e-9);
            }
        }
    }
}
