//! Motion: from wanted piston positions to the exact instants of the microsteps.
//!
//! The way of one move, room by room:
//!
//! 1. The loop calls [`Motion::tick`] once a control tick with the three wanted piston positions.
//! 2. When they changed, [`solver::Ruckig`] plans from the position, velocity and acceleration of this
//!    instant to rest at the new target: jerk-limited, time-optimal for the slowest channel and
//!    stretched for the two others so that all three arrive together. No stop in between.
//! 3. The plan is believed only after [`plan::Plan::verify`] has gone over every phase of it. A plan
//!    that fails is thrown away, the one in hand is followed a few ticks longer, then [`stop`] brakes.
//! 4. A tick's worth is cut out as a [`Segment`]: constant-jerk pieces a channel, state at both ends.
//! 5. A simulation takes the end of the segment and rounds it to counts. Hardware sends the segment
//!    through the ring of [`queue`] to the step thread.
//! 6. There [`steps`] solves each piece for the instants at which the position passes the middle
//!    between two microsteps, and [`pulse::StepCore`] decides at every instant which line to move.
//!
//! Nothing here fetches the time, touches a pin, allocates after construction or takes a lock.
//!
//! What holds at every tick, whatever the targets: position within travel, speed, acceleration and
//! jerk within their limits (1e-6 relative), and a stop within the limits *and within travel* is
//! possible from where the tick ends. So running dry, losing the loop or failing to plan are all
//! survived by braking.

pub mod config;
pub mod cruise;
pub mod follow;
pub mod histogram;
pub mod limits;
pub mod lines;
pub mod plan;
pub mod pulse;
pub mod queue;
pub mod report;
pub mod segment;
pub mod solver;
pub mod state;
pub mod steps;
pub mod stop;

pub use config::{ConfigError, MotionConfig, StepperConfig};
pub use follow::{Motion, MoveStatus};
pub use limits::MotionLimits;
pub use segment::{ChannelSegment, Segment};
pub use state::MotionState;
