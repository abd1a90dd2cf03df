//! Design of a schedule on which the effects lie as far apart as possible.

pub mod design;
pub mod distance;
pub mod manoeuvre;
pub mod points;
pub mod rows;
pub mod standard;
pub mod synthetic;
