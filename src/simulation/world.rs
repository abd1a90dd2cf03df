//! The worlds the loop can live in: one trait, lockstep.
//!
//! A world takes microstep counts, lets its time go on by one period, and answers with what the
//! sensors said. What a world knows of the *true* orientation travels beside the reading and never
//! into [`crate::control::tick::Input`]: it is for the judge alone.

use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Seconds, Steps};
use crate::simulation::plant::PlantError;
use crate::supervisor::machine::{MachineError, MachineInfo};

/// Answer to one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply {
    /// Time reached.
    pub t: Seconds,
    /// A sample, if the sensor had one.
    pub imu: Option<ImuSample>,
    /// True tip orientation relative to rest, for the judge.
    pub truth: Option<Rotation<Base, Tip>>,
}

/// Something that moves when microsteps are counted.
pub trait World {
    /// What it is.
    fn info(&self) -> &MachineInfo;
    /// Holds the counts for one period and answers.
    ///
    /// # Errors
    /// [`MachineError`] when the other side is gone, silent or talks nonsense.
    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError>;
}

impl From<PlantError> for MachineError {
    fn from(e: PlantError) -> Self {
        Self::Plant(e.to_string())
    }
}
