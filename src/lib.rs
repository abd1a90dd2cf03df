//! Closed-loop bend control and sim-to-real gap diagnosis for a disposable pneumatic endoscope tip.
//!
//! The house has floors; a file imports only from floors below its own, or from earlier rooms of its
//! own floor:
//!
//! | floor | rooms |
//! |---|---|
//! | F0 words | [`units`], [`frames`], [`sample`] |
//! | F1 laws: pure, stateless | [`model`] |
//! | F2 behaviour: config + state → output | [`fuse`], [`control`], [`refine`], [`tick`] |

pub mod cli;
pub mod config;
pub mod control;
pub mod effects;
pub mod experiment;
pub mod frames;
pub mod fuse;
pub mod link;
pub mod log;
pub mod model;
pub mod refine;
pub mod sample;
pub mod tick;
pub mod units;
pub mod world;
