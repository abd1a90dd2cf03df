//! Closed-loop bend control and sim-to-real gap diagnosis for a disposable pneumatic endoscope tip.
//!
//! The house has floors; a file imports only from floors below its own:
//!
//! | floor | rooms |
//! |---|---|
//! | F0 words | [`units`], [`frames`], [`sample`] |
//! | F1 laws | [`model`] |
//! | F3 twins, judges | [`plant`] |

pub mod frames;
pub mod model;
pub mod plant;
pub mod sample;
pub mod units;
