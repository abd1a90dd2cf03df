//! Units, frames, samples and range checks: the words that every other room uses.

pub mod check;
pub mod frames;
pub mod sample;
pub mod units;
