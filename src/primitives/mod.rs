//! Units, frames, samples and the parameter table: the vocabulary of every other room.

pub mod check;
pub mod frames;
pub mod parameters;
pub mod sample;
pub mod units;
