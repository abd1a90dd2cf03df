//! Design of a schedule on which the effects lie as far apart as possible.

pub mod design;
pub mod distance;
pub mod manoeuvre;
pub mod rows;
pub mod standard;
pub mod synthetic;

pub use design::{APART, Design, LONGEST_S, Pair, Request, design};
pub use distance::{Rival, information};
pub use manoeuvre::{Manoeuvre, first_guess, schedule};
pub use rows::{Machine, ScheduleRow, rounded};
