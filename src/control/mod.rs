//! From a target bend to piston targets: set-point profile, feedback, limits, learning.

pub mod backlash_adaptation;
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
