//! Configuration, input and output of a tick.

use crate::control::calm::CalmConfig;
use crate::control::dynamics::{Dynamics, DynamicsPrior};
use crate::control::follow::Pace;
use crate::control::limits::{ActuatorLimits, Cut};
use crate::control::observer::{ObserverConfig, PeriodicConfig};
use crate::control::obstruction::ObstructionConfig;
use crate::control::refine::RefineConfig;
use crate::control::saturation::Saturation;
use crate::estimation::fusion::health::{CauseSet, HealthAction};
use crate::estimation::fusion::tip::{FuseConfig, TipEstimate};
use crate::estimation::imu_calibration::Correction;
use crate::estimation::imu_calibration::motor::MotorField;
use crate::model::{Bend, DescribedMachine, Drive, Geometry, Line, Shape, Side};
use crate::motion::DriveLimits;
use crate::parameters;
use crate::primitives::{ImuReading, ImuSample, Seconds, Steps};
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
    /// Standard deviations of k_ε and of k_λ in mm, per channel.
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
    /// Settings of the feedback; `None` for an open loop.
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
}

parameters! {
    /// The outer loop: a PI controller on the observer's belief about the bend.
    pub struct FeedbackConfig: Copy {
        /// Proportional gain: fraction of the expected error that one move corrects. A larger value needs fewer moves, and passes more of
        /// an error of the model to the tip.
        kp: f64 = 1.0, "", 0.05..=1.5, "1 trusts the observer's model, which learns";
        /// Integral rate: how fast g, what the model does not explain, follows the estimate at rest. A larger value corrects a disturbance
        /// sooner and passes more of the estimate's noise to the pistons.
        ki_1_s: f64 = 23.0, "1/s", 0.1..=1000.0, "23 follows within 45 ms, the noise of a quiet IMU averaged over five samples";
        /// Limit of what is corrected beyond the learned laws, in degrees of bend. A larger value follows what no law explains further.
        integral_max_deg: f64 = 60.0, "deg", 0.0..=180.0, "60 leaves the bound to the limits of pistons and pressure";
        /// A tip at rest is moved when the error exceeds this many standard deviations of what the move risks. A larger value moves less
        /// often and leaves a larger error.
        caution: f64 = 0.5, "sigma", 0.0..=10.0, "below 1, because the next move corrects what a wrong one leaves";
        /// Error that is never corrected. A larger value moves less often.
        step_deg: f64 = 0.086, "deg", 0.0..=10.0, "0.086 is some microsteps";
        /// Common length that may be spent so that no line crosses its backlash. A larger value avoids more reversals and lengthens the tip.
        free_length_mm: f64 = 0.25, "mm", 0.0..=5.0, "0.25 is half a millimetre of piston";
        /// Fraction of the lag by which the feedforward leads. 0 does not lead; more than 1 overshoots.
        lead: f64 = 1.0, "", 0.0..=1.5, "1 leads by the whole lag";
        /// Learns lag and dead time during operation.
        learn_dynamics: bool = true;
    }
    set in code {
        /// The observer.
        observer: ObserverConfig = ObserverConfig::default();
        /// A periodic disturbance.
        periodic: PeriodicConfig = PeriodicConfig::default();
        /// Slow corrections.
        calm: CalmConfig = CalmConfig::default();
        /// The obstruction detector.
        obstruction: ObstructionConfig = ObstructionConfig::default();
    }
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
    pub command: Option<Shape>,
    /// The moving reference of this tick, in place of targets.
    pub reference: Option<Reference>,
    /// Microsteps counted so far.
    pub steps: Steps,
    /// The loop does not lead: something else moves the pistons, or they stand.
    pub idle: bool,
    /// A line is suspected: what it does now is not taken for what it was.
    pub suspected: bool,
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

/// What the observer believes about the tip.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct Belief {
    /// Bend once the tip has settled at the counted pistons, rad.
    pub settled: Vector2<f64>,
    /// Standard deviation of it, rad.
    pub sigma_rad: f64,
    /// Part of it that no law explains: the integral part of the loop, rad.
    pub residual: Vector2<f64>,
    /// Standard deviations of k_ε and of k_λ in mm, per channel.
    pub line_sigmas: [[f64; 2]; 3],
    /// Largest plausible error of lag plus dead time, s.
    pub response_error_s: f64,
    /// Frequency of a periodic disturbance that is cancelled, Hz.
    pub periodic_hz: Option<f64>,
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

/// Largest bend error of a settled tip, degrees.
pub const SETTLED_DEG: f64 = 1.0;

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
    /// Bend that the counted steps cause by the gains as they were when the set-point last left a pose, rad.
    pub bend_from_pistons: Bend,
    /// Bend that the observer predicts for now from the counted steps, without what no law explains, rad.
    pub predicted: Vector2<f64>,
    /// Predicted minus estimated bend, rad.
    pub unexplained: Vector2<f64>,
    /// Feedback part of the bend command, rad.
    pub feedback: Vector2<f64>,
    /// Bend that the channels are to make: set-point, lead and feedback, rad.
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
    /// The set-point rests and the loop has not moved the tip for as long as an answer takes.
    pub at_rest: bool,
    /// The tip does not follow the feedback.
    pub blocked: bool,
    /// What the observer believes.
    pub belief: Belief,
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
