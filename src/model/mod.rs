//! Kinematics and transmission of the tip (paper, Eq. 1-17), forward beside inverse, and the effects beyond them.

pub mod arc;
pub mod bend;
pub mod chain;
pub mod described;
pub mod drive;
pub mod effects;
pub mod transmission;
