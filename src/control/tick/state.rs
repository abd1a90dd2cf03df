//! State of the loop from tick to tick.

use super::setpoint::SetPoint;
use super::types::LoopConfig;
use crate::control::backlash_adaptation::BacklashAdaptation;
use crate::control::calm::CalmCorrection;
use crate::control::feedforward::FeedforwardState;
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
use nalgebra::{Vector2, Vector3};

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

    /// Exchanges the gains while the pistons stay. Returns the change of the intended bend, rad.
    pub(super) fn exchange(&mut self, geometry: &Geometry, next: &[Line; 3]) -> Vector2<f64> {
        let before = self.intended_shape(geometry).bend.0;
        self.lines = *next;
        self.intended_shape(geometry).bend.0 - before
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
    pub(super) calm: CalmCorrection,
    pub(super) standstill: StandstillLatch,
    /// Time since the latch closed, s.
    pub(super) standstill_s: f64,
    pub(super) obstruction: ObstructionDetector,
    pub(super) hunting: HuntingDetector,
    /// What was known when the set-point left the last poses that nothing obstructed, the latest first.
    pub(super) taught: [Option<Taught>; 16],
    /// The base sways, and the time for which it has, s.
    pub(super) sways: bool,
    pub(super) sways_s: f64,
    /// The set-point moves.
    pub(super) moving: bool,
    pub(super) saturation: SaturationMonitor,
    pub(super) backlash: BacklashAdaptation,
}

/// What the poses before a departure have taught.
#[derive(Debug, Clone, Copy)]
pub(super) struct Taught {
    pub(super) pi: PiState,
    pub(super) error: StaticError,
    pub(super) refine: RefineState,
    pub(super) lines: [Line; 3],
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
        Self {
            fusion: Fusion::default(),
            motors: MotorActivity {
                last_steps: Steps::default(),
                idle_s: [f64::INFINITY; 3],
                still_s: 0.0,
            },
            setpoint: SetPoint::resting(Shape {
                bend: Bend::STRAIGHT,
                length: Mm(config.geometry.rest_length_mm),
            }),
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
            self.feedback.taught = Default::default();
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
            let side = if line.k_lambda_mm > 0.0 {
                ((piston_mm[i] - w_mm) / line.k_lambda_mm).clamp(-1.0, 1.0)
            } else {
                0.0
            };
            lines.play_output_mm[i] = w_mm;
            lines.intended_mm[i] = w_mm;
            lines.sides[i] = SideState {
                w_mm,
                side,
                way: if side == 0.0 { 0.0 } else { side.signum() },
            };
        }
        let mut given = lines.intended_shape(&config.geometry);
        if let Some(machine) = config.feedforward.as_deref() {
            let mut described = FeedforwardState::new(machine);
            given = described.advance(machine, &lines.intended_mm, SETTLED_S);
            lines.described = Some(described);
        }
        let length = given.length.0.clamp(
            0.5 * config.geometry.rest_length_mm,
            2.0 * config.geometry.rest_length_mm,
        );
        self.setpoint = SetPoint::resting(Shape {
            bend: at,
            length: Mm(length),
        });
        let feedback = given.bend.0 - at.0;
        let (error, integral) = (
            self.feedback.error,
            feedback - self.feedback.error.at(&at.0),
        );
        let pi = PiState {
            integral,
            feedback: integral,
        };
        let taught = Taught {
            pi,
            error,
            refine: self.learning.refine,
            lines: self.transmission.lines,
        };
        let mut backlash = self.feedback.backlash;
        backlash.forget();
        self.feedback = Feedback {
            model: ReferenceModel::resting(given.bend.0),
            pi,
            error,
            taught: std::array::from_fn(|i| (i == 0).then_some(taught)),
            feedback,
            backlash,
            hunting: HuntingDetector::new(self.feedback.hunting.caution),
            ..Feedback::default()
        };
        self.hold = Hold::RELEASED;
        self.targets_mm = piston_mm;
        self.motors.last_steps = *steps;
    }

    /// Returns to what earlier poses have taught, while the pistons stay. Returns the change of the intended bend, rad.
    pub(super) fn return_to(&mut self, config: &LoopConfig, taught: &Taught) -> Vector2<f64> {
        (self.feedback.error, self.learning.refine) = (taught.error, taught.refine);
        let shift = self.transmission.exchange(&config.geometry, &taught.lines);
        self.shift_model(shift);
        shift
    }

    /// The gains have changed, so that the model now predicts a bend that differs by `shift`, rad.
    pub(super) fn shift_model(&mut self, shift: Vector2<f64>) {
        self.feedback.model.shift(shift);
        self.base.watch.shift(&shift);
    }

    /// Removes the feedback and what was learned from the command, for an open loop.
    pub fn forget_feedback(&mut self) {
        self.feedback.pi = PiState::default();
        self.feedback.error = StaticError::default();
        self.feedback.taught = Default::default();
        self.feedback.feedback = Vector2::zeros();
        self.feedback.integral_full = false;
        self.feedback.saturation = SaturationMonitor::default();
    }
}
