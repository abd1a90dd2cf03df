//! From a wanted bend to piston targets: set-point profile, feedback, limits, mode.

pub mod follow;
pub mod learning;
pub mod limit;
pub mod pi;
pub mod reach;
pub mod rest;
pub mod spent;
pub mod tick;
pub mod wall;
