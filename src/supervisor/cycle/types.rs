//! Configuration and output of the supervisor.

use crate::control::{CauseSet, Frame, Input, LoopConfig};
use crate::primitives::Steps;
use crate::supervisor::cycle::restart_check::RestartCheckConfig;
use crate::supervisor::residual_monitor::Suspicion;
use crate::supervisor::{
    GateLimits, Mode, Order, Refusal, ResidualConfig, Sensed, Source, TripCause,
};

/// Everything that stays constant while the supervisor runs, except for a reload.
#[derive(Debug, Clone, PartialEq)]
pub struct SupervisorConfig {
    /// The control loop.
    pub tick: LoopConfig,
    /// The safety gate.
    pub gate: GateLimits,
    /// The residual monitor.
    pub residual: ResidualConfig,
    /// The check of the remembered pose after a restart.
    pub restart_check: RestartCheckConfig,
    /// Longest gap between two set-points of a stream, s.
    pub dead_man_s: f64,
}

/// Output of one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleOutput {
    /// Every intermediate of the tick.
    pub frame: Frame,
    /// Input of the tick.
    pub input: Input,
    /// Input of the cycle, bit for bit, as the flight log holds it.
    pub sensed: Sensed,
    /// Order of this cycle.
    pub order: Option<Order>,
    /// Answer to the order.
    pub answer: Option<Result<(), Refusal>>,
    /// Mode after the cycle.
    pub mode: Mode,
    /// Counts to send.
    pub steps: Steps,
    /// Counts reported by the machine.
    pub counted: Steps,
    /// The drivers shall be energised.
    pub energise: bool,
    /// The machine shall clear its alarm.
    pub clear: bool,
    /// New counts for the present position of the pistons.
    pub recount: Option<Steps>,
    /// Cause of a trip in this cycle.
    pub tripped: Option<TripCause>,
    /// Latched cause.
    pub latched: Option<TripCause>,
    /// Present suspicion of the residual monitor.
    pub suspicion: Option<Suspicion>,
    /// The suspicion is new in this cycle.
    pub suspects: bool,
    /// Causes that came into force against the sensor in this cycle.
    pub raised: CauseSet,
    /// The IMU on the base: whether it measures the turns of the base, and the causes in force against it.
    pub base_imu: Option<(bool, CauseSet)>,
    /// Causes that came into force against it in this cycle.
    pub base_raised: CauseSet,
    /// The gyroscope bias differs from that of the alignment.
    pub bias_moved: bool,
    /// A stream of set-points fell silent in this cycle, and the tip was stopped.
    pub stream_ended: bool,
    /// Where the set-point comes from.
    pub source: Source,
    /// A stop is latched.
    pub stopped: bool,
    /// No measurement has confirmed the last zero.
    pub unverified: bool,
    /// Time since the last cycle, s.
    pub dt_s: f64,
    /// The first cycle of this supervisor.
    pub first: bool,
}
