//! Configuration, input and output of a tick.

use crate::control::calm::CalmConfig;
use crate::control::follow::Pace;
use crate::control::learning::batch::Prior;
use crate::control::learning::online::RefineConfig;
use crate::control::limits::{ActuatorLimits, Cut};
use crate::control::obstruction::ObstructionConfig;
use crate::control::pi::{Dynamics, DynamicsPrior};
use crate::control::saturation::Saturation;
use crate::control::standstill::StandstillConfig;
use crate::estimation::fusion::health::{CauseSet, HealthAction, ImuReading};
use crate::estimation::fusion::tip::{FuseConfig, TipEstimate};
use crate::estimation::imu_calibration::Correction;
use crate::estimation::imu_calibration::motor::MotorField;
use crate::model::{Bend, DescribedMachine, Drive, Geometry, Line, Shape, Side};
use crate::motion::DriveLimits;
use crate::parameters;
use crate::primitives::{ImuSample, Mm, Seconds, Steps};
use nalgebra::{Vector2, Vector3};
use std::sync::Arc;

/// Configuration of the loop. It stays constant while the loop runs.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopConfig {
    /// Geometry of the bending section.
    pub geometry: Geometry,
    /// Rack and pinion.
    pub drive: Drive,
    /// Calibrated transmission gains: the initial feedforward and the prior of the refinement.
    pub lines: [Line; 3],
    /// Standard deviations of k_ε and of k_λ in mm, per channel: how far the refinement may take them.
    pub line_sigmas: [[f64; 2]; 3],
    /// Lag and dead time before any motion.
    pub dynamics: DynamicsPrior,
    /// How the backlash compensation reverses.
    pub side: Side,
    /// Pace of the bend set-point, rad/s and rad/s².
    pub bend_pace: Pace,
    /// Pace of the centre length, mm/s and mm/s².
    pub length_pace: Pace,
    /// How the machine moves each piston to its target.
    pub motion: DriveLimits,
    /// Static limits of the pistons and bellows.
    pub limits: ActuatorLimits,
    /// Settings of the outer loop; `None` for an open loop.
    pub feedback: Option<FeedbackConfig>,
    /// The machine as a diagnosis describes it, for the feedforward; `None` for the nominal model. Its gains are [`Self::lines`].
    pub feedforward: Option<Arc<DescribedMachine>>,
    /// Online refinement of k_ε.
    pub refine: RefineConfig,
    /// Orientation estimation.
    pub fuse: FuseConfig,
    /// Correction of the tip IMU, applied to every sample.
    pub imu: Correction,
    /// Calibrated fields of the motor coils, subtracted from the magnetometer.
    pub motors: Option<MotorField>,
    /// Time after its last step at which a driver reduces its current, s.
    pub motors_idle_after_s: f64,
}

impl LoopConfig {
    /// The same loop with a feedforward through `machine`, with the gains of the machine.
    #[must_use]
    pub fn fed_forward(self, machine: Arc<DescribedMachine>) -> Self {
        Self {
            lines: machine.chain().lines,
            feedforward: Some(machine),
            ..self
        }
    }

    /// The calibrated gains with their standard deviations.
    pub fn line_priors(&self) -> [Prior; 3] {
        std::array::from_fn(|i| {
            let [k_epsilon_sigma, k_lambda_sigma_mm] = self.line_sigmas[i];
            Prior {
                line: self.lines[i],
                k_epsilon_sigma,
                k_lambda_sigma_mm,
            }
        })
    }
}

parameters! {
    /// The outer loop: from the bend error to the bend command.
    pub struct FeedbackConfig: Copy {
        /// Closed-loop time constant: the error that the feedforward leaves falls to a third within this time. A larger
        /// value is calmer and slower. A dead time raises it automatically.
        tau_c_s: f64 = 0.1, "s", 0.01..=10.0, "0.1 is brisk, 0.5 is calm";
        /// Upper limit of the proportional gain, rad of command per rad of error. A larger value drives a slow line harder
        /// and passes more of the estimate's noise to the pistons.
        kp_max: f64 = 2.0, "", 0.0..=10.0, "2 suits an estimate with 0.05° of noise";
        /// Limit of the integral part, in degrees of bend. A larger value over-drives a lossy line further.
        integral_max_deg: f64 = 60.0, "deg", 0.0..=180.0, "60 compensates for a line that has lost half of its gain";
        /// Fraction of the lag by which the feedforward leads. 0 does not lead; more than 1 overshoots.
        lead: f64 = 1.0, "", 0.0..=1.5, "1 leads by the whole lag";
        /// Learns lag and dead time during operation.
        learn_dynamics: bool = true;
        /// Learns the static error of the model as a function of the bend; without it, every new target starts with the
        /// feedback of the last.
        learn_error: bool = true;
        /// Learns how much of the backlash a reversal by feedback crosses; without it, all of it.
        learn_backlash: bool = true;
    }
    set in code {
        /// Slow corrections.
        calm: CalmConfig = CalmConfig::default();
        /// The standstill latch.
        standstill: StandstillConfig = StandstillConfig::default();
        /// The obstruction detector.
        obstruction: ObstructionConfig = ObstructionConfig::default();
    }
}

/// A target for the tip.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Command {
    /// Bend vector, rad.
    pub bend: Bend,
    /// Centre length, mm.
    pub length: Mm,
}

/// Where a moving tip is to be, for the time at which it answers the command of this tick ([`super::LoopState::answers_after_s`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    /// Bend and length.
    pub shape: Shape,
    /// Rate of the bend vector, rad/s.
    pub rate: Vector2<f64>,
    /// Acceleration of the bend vector, rad/s².
    pub acceleration: Vector2<f64>,
}

/// Input of one tick; by default neither sample nor command.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Input {
    /// Time of the tick.
    pub t: Seconds,
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// Sample of the tip IMU, failed transfer, or nothing.
    pub imu: ImuReading,
    /// Sample of the base IMU, if there is one.
    pub base_imu: Option<ImuSample>,
    /// A new target.
    pub command: Option<Command>,
    /// The moving reference of this tick, in place of targets.
    pub reference: Option<Reference>,
    /// Microsteps counted so far.
    pub steps: Steps,
    /// Requests a new alignment because the base was turned.
    pub realign: bool,
}

/// State of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Senses {
    /// The most severe action that the sensor health requires.
    pub action: HealthAction,
    /// Causes in force against the sensor.
    pub in_force: CauseSet,
    /// The pistons stand because of the sensors.
    pub held: bool,
    /// The two orientation filters have disagreed for long.
    pub disagrees: bool,
}

/// Phase of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub enum TickPhase {
    /// Waits for a still tip; the pistons stand.
    Aligning,
    /// The set-point moves.
    Tracking,
    /// The set-point rests.
    Holding,
}

/// Output and intermediates of one tick. The supervisor, the status, the bend log and the flight log take their
/// values from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Time of the tick.
    pub t: Seconds,
    /// Phase of the loop.
    pub phase: TickPhase,
    /// Target, limited to the range of the bellows.
    pub target: Shape,
    /// Set-point on its way to the target.
    pub setpoint: Shape,
    /// Estimated orientation and bend, once aligned.
    pub estimate: Option<TipEstimate>,
    /// Bend that the counted steps cause according to the transmission model, rad.
    pub bend_from_pistons: Bend,
    /// Bend that the reference model (lag and dead time) predicts from the counted steps, rad.
    pub predicted: Vector2<f64>,
    /// Predicted minus estimated bend: the input of the PI controller, rad.
    pub unexplained: Vector2<f64>,
    /// Feedback part of the bend command, rad.
    pub feedback: Vector2<f64>,
    /// Bend command: set-point, lead and feedback, rad.
    pub command: Bend,
    /// Commanded bellow length changes q, mm.
    pub bellow_mm: Vector3<f64>,
    /// Piston targets q̃ after limits, mm.
    pub piston_target_mm: Vector3<f64>,
    /// The targets in microsteps. The machine moves there within the limits of motion.
    pub steps: Steps,
    /// k_ε in use.
    pub k_epsilon: [f64; 3],
    /// k_λ in use, mm.
    pub k_lambda_mm: [f64; 3],
    /// Lag and dead time in use.
    pub dynamics: Dynamics,
    /// Limit that cut the request.
    pub cut: Cut,
    /// The standstill latch is closed.
    pub at_rest: bool,
    /// The tip does not follow the feedback.
    pub blocked: bool,
    /// The loop has driven the tip to and fro at the present target, and has become slower.
    pub hunting: bool,
    /// Integral time λ of the controller, s.
    pub integral_s: f64,
    /// The controller has reached a limit and the tip is still off target.
    pub saturation: Saturation,
    /// State of the sensors.
    pub senses: Senses,
    /// The base has turned. Later poses have the feedforward alone, until the unexplained bend has come back or the next
    /// alignment.
    pub base_moved: bool,
    /// The tip twists as its mechanism cannot: the base may have turned slowly. The loop continues.
    pub base_doubted: bool,
}
