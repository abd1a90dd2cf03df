//! What watches the loop: the modes it may be in, the gate its steps must pass, the words for a fault.
//!
//! * [`mode`]: one table of transitions, and nothing else changes the mode.
//! * [`gate`]: stands between the controller and the step generator and believes neither.
//! * [`explain`]: from the difference between what the pistons did and what the tip felt to a cause.
//!
//! All of it is pure: time is passed in, nothing is fetched, nothing allocates.

pub mod explain;
pub mod gate;
pub mod mode;
