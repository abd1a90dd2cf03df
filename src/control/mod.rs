//! From a target bend to piston targets: set-point profile, feedback, limits, learning.

pub mod backlash_adaptation;
pub mod calm;
pub mod feedforward;
pub mod follow;
pub mod hunting;
pub mod learning;
pub mod limits;
pub mod obstruction;
pub mod path;
pub mod pi;
pub mod saturation;
pub mod standstill;
pub mod tick;

pub use calm::CalmConfig;
pub use follow::Pace;
pub use limits::ActuatorLimits;
pub use path::Path;
pub use pi::{Dynamics, DynamicsPrior};
pub use standstill::StandstillConfig;
pub use tick::{
    Command, FeedbackConfig, Frame, Input, LoopConfig, LoopState, Reference, RestartRest,
    RestartState, TickPhase,
};
