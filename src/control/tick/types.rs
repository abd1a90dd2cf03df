//! What a tick is made of: its configuration, what it is told, and the frame it leaves.

use crate::control::follow::Pace;
use crate::control::learning::online::RefineConfig;
use crate::control::limits::{ActuatorLimits, Cut};
use crate::control::obstruction::ObstructionConfig;
use crate::control::pi::Dynamics;
use crate::control::saturation::Saturation;
use crate::control::standstill::StandstillConfig;
use crate::estimation::fusion::health::{CauseSet, HealthAction, ImuReading as Reading};
use crate::estimation::fusion::tip::{FuseConfig, TipEstimate};
use crate::estimation::imu_calibration::Correction;
use crate::estimation::imu_calibration::motor::MotorField;
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::model::drive::Drive;
use crate::model::transmission::{Line, Side};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Mm, Seconds, Steps};
use nalgebra::{Vector2, Vector3};

/// Everything that does not change while the loop runs.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopConfig {
    /// Bellows and backbone.
    pub geometry: Geometry,
    /// Rack and pinion.
    pub drive: Drive,
    /// Calibrated transmission: feedforward at start and prior of the refinement.
    pub lines: [Line; 3],
    /// Lag and dead time at start.
    pub dynamics: Dynamics,
    /// How the backlash compensation changes sides.
    pub side: Side,
    /// Pace of the bend set-point, rad/s and rad/s².
    pub bend_pace: Pace,
    /// Pace of the centre length, mm/s and mm/s².
    pub length_pace: Pace,
    /// Pace of each piston, mm/s and mm/s².
    pub piston_pace: Pace,
    /// Static limits.
    pub limits: ActuatorLimits,
    /// The outer loop; `None` runs open loop.
    pub feedback: Option<FeedbackConfig>,
    /// Online refinement of k_ε.
    pub refine: RefineConfig,
    /// Orientation estimation.
    pub fuse: FuseConfig,
    /// The tip IMU's own errors, taken off every sample.
    pub imu: Correction,
    /// Fields of the motors' coils, taken off the magnetometer, where they have been calibrated.
    pub motors: Option<MotorField>,
    /// A driver idles this long after its last step, s.
    pub motors_idle_after_s: f64,
}

/// The outer loop's settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedbackConfig {
    /// Closed-loop time constant τ_c, s.
    pub tau_c_s: f64,
    /// Cap of K_p.
    pub kp_max: f64,
    /// Bound of the integrator, rad.
    pub integral_max_rad: f64,
    /// Share of the lag that the feedforward leads by, 0..=1.
    pub lead: f64,
    /// Learn lag and dead time while running.
    pub learn_dynamics: bool,
    /// The rest latch.
    pub rest: StandstillConfig,
    /// The watch for a tip that is held.
    pub wall: ObstructionConfig,
}

/// Where the tip shall go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Wanted bend.
    pub bend: Bend,
    /// Wanted centre length.
    pub length: Mm,
}

/// What one tick is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Input {
    /// Time of the tick.
    pub t: Seconds,
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// What came from the tip's IMU: a sample, a failed transfer or nothing.
    pub imu: Reading,
    /// A sample of the base's IMU, where there is one.
    pub base_imu: Option<ImuSample>,
    /// A new target, if one came.
    pub command: Option<Command>,
    /// Microsteps that were pulsed by now.
    pub steps: Steps,
    /// Take the next still stretch for the rest again: the base was turned.
    pub realign: bool,
}

impl Default for Input {
    /// Nothing came yet, on a loop of 1 kHz.
    fn default() -> Self {
        Self { t: Seconds(0.0), dt_s: 1e-3, imu: Reading::Nothing, base_imu: None, command: None, steps: Steps::default(), realign: false }
    }
}

/// State of the senses, for the status and the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Senses {
    /// The harshest thing the judge of readings asks for.
    pub action: HealthAction,
    /// What is counted against the sensor.
    pub in_force: CauseSet,
    /// The pistons are held because of it.
    pub held: bool,
    /// The second opinion has differed for long.
    pub disagrees: bool,
}

/// What the loop is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TickPhase {
    /// Waiting for a still tip; pistons stay.
    Aligning,
    /// The set-point moves.
    Tracking,
    /// The set-point rests.
    Holding,
}

/// Every intermediate of one tick: the tick's output, the log record, the gap engine's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Time of the tick.
    pub t: Seconds,
    /// What the loop was doing.
    pub mode: TickPhase,
    /// The target as commanded.
    pub target: Shape,
    /// The set-point on its way to the target.
    pub setpoint: Shape,
    /// Felt orientation, once aligned.
    pub estimate: Option<TipEstimate>,
    /// Bend that the pistons as they stand should give, rad.
    pub bend_from_pistons: Bend,
    /// Error that the PI acted on, rad.
    pub error: Vector2<f64>,
    /// Feedback in the command, rad.
    pub feedback: Vector2<f64>,
    /// Commanded bellow length change q, mm.
    pub bellow_mm: Vector3<f64>,
    /// Piston targets q̃ after limits, mm.
    pub piston_target_mm: Vector3<f64>,
    /// Microsteps to pulse until the next tick.
    pub steps: Steps,
    /// k_ε in use.
    pub k_epsilon: [f64; 3],
    /// Lag and dead time in use.
    pub dynamics: Dynamics,
    /// What cut the request.
    pub cut: Cut,
    /// Held by the rest latch.
    pub at_rest: bool,
    /// Pushed without coming.
    pub blocked: bool,
    /// The controller has done what it may, and the tip is still off.
    pub spent: Saturation,
    /// How the sensors are.
    pub senses: Senses,
    /// The base has turned: the integrator is frozen until a re-alignment.
    pub base_moved: bool,
    /// The tip twists against its mechanism: the base may have turned slowly. The loop goes on.
    pub base_doubted: bool,
}
