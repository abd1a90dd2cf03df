//! Units, frames, samples, the parameter table and text files: the vocabulary of every other room.

pub mod check;
pub mod constants;
pub mod file;
pub mod frames;
pub mod parameters;
pub mod sample;
pub mod units;

pub use check::{Checker, Invalid, shown};
pub use constants::{FOREIGN_SIGMAS, LIKELY_SIGMAS, SURE_SIGMAS, UNEXPLAINED_SIGMAS};
pub use frames::{Base, Rotation, Sensor, Tip, World};
pub use parameters::{Allowed, Check, Parameter, Parameters, Setting, Shape, Table, join};
pub use sample::{ImuReading, ImuSample, Quality, ReadFault};
pub use units::{Mm, Rad, Seconds, Steps, lasting};
