//! From a target bend to piston targets: set-point profile, feedback, limits, learning.

pub mod calm;
pub mod dynamics;
pub mod feedforward;
pub mod follow;
pub mod inverse;
pub mod learning;
pub mod limits;
pub mod observer;
pub mod obstruction;
pub mod path;
pub mod refine;
pub mod rule;
pub mod saturation;
pub mod tick;

pub use crate::estimation::fusion::health::{CauseSet, HealthCause};
pub use crate::model::{Drive, Geometry, Line, Side};
pub use calm::CalmConfig;
pub use dynamics::{Dynamics, DynamicsPrior};
pub use follow::Pace;
pub use limits::ActuatorLimits;
pub use path::Path;
pub use tick::{
    FeedbackConfig, Frame, Input, LoopConfig, LoopState, Reference, RestartRest, RestartState,
    SETTLED_DEG, TickPhase,
};
