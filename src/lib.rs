//! Closed-loop bend control and sim-to-real gap diagnosis for a disposable pneumatic endoscope tip.
//!
//! The house has floors; a file imports only from floors below its own:
//!
//! | floor | rooms |
//! |---|---|
//! | F0 words | [`units`], [`frames`], [`sample`] |
//! | F1 laws | [`model`] |

pub mod frames;
pub mod io;
pub mod model;
pub mod motion;
pub mod sample;
pub mod units;
