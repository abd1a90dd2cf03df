//! Closed-loop bend control and sim-to-real gap diagnosis for a disposable pneumatic endoscope tip.
//!
//! The house has floors; a file imports only from floors below its own:
//!
//! | floor | rooms |
//! |---|---|
//! | F0 words | [`units`], [`frames`], [`sample`] |
//! | F1 laws | [`model`] |
//! | F2 behaviour | [`fuse`] |
//! | F3 judges | [`log`], [`imu_score`] |

pub mod frames;
pub mod fuse;
pub mod imu_score;
pub mod log;
pub mod model;
pub mod sample;
pub mod units;
