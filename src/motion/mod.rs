//! Motion: from target piston positions to the exact instants of the microsteps, and the trait [`Machine`] of whatever makes them.
//!
//! One move takes this path:
//!
//! 1. The [`drive::Drive`] calls [`Motion::tick`] once per control tick with three target positions.
//! 2. When a target has changed, [`solver::Ruckig`] plans from the present position, velocity and
//!    acceleration to rest at the new target. The plan is jerk-limited, and time-optimal for each
//!    channel on its own.
//! 3. [`plan::Plan::verify`] checks every phase of the plan. If a plan fails, the previous one is
//!    followed for a few more ticks; after that, the pistons brake.
//! 4. The tick's share of the plan is cut out as a [`Segment`]: constant-jerk pieces for each channel
//!    with the states at both ends.
//! 5. The segment travels through the wait-free ring of [`queue`] to the step generator.
//! 6. The step generator solves each piece for the instants at which the position passes the midpoint
//!    between two microsteps ([`steps`]), and [`pulse::StepCore`] decides at each instant which lines
//!    change.
//!
//! On hardware the step generator is a thread that pulses pins. In simulation it is the same step core in simulated time;
//! its pulses take no time and are never late.
//!
//! Nothing here reads a clock, touches a pin, takes a lock or allocates after construction.
//!
//! The following holds at every tick for any targets: position stays within travel; speed,
//! acceleration and jerk stay within their limits (1e-6 relative); and from the end of the tick a stop
//! within the limits *and within travel* is possible. Braking is therefore a safe answer to an
//! underrun, a lost loop or a failed plan.

pub mod config;
pub mod drive;
pub mod follow;
pub mod histogram;
pub mod lines;
pub mod machine;
pub mod plan;
pub mod pulse;
pub mod queue;
pub mod report;
pub mod segment;
pub mod solver;
pub mod state;
pub mod steps;
pub mod stop;

pub use histogram::Histogram;
pub use lines::{EmergencyStop, Inputs, Levels, PulseTiming};
pub use machine::{Alarm, Gauges, Machine, MachineError, MachineInfo, Sensed};
pub use pulse::{PulseAction, StepCore};
pub use report::{DriveState, StepperFault, StepperMode, StepperOrder, StepperReport};
pub use stop::Stop;

pub use config::{MotionLimits, StepperConfig};
pub use drive::{Drive, DriveLimits, StepGenerator};
pub use follow::{Motion, MoveStatus};
pub use segment::{ChannelSegment, Segment};
pub use state::MotionState;
