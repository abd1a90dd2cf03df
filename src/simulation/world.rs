//! The interface of a simulated machine in lockstep.
//!
//! A world takes microstep counts, advances by one period, and returns the sensor reading. The *true* orientation
//! is returned beside the reading, for scoring only; it never becomes part of the input of the loop.

use crate::motion::{MachineError, MachineInfo};
use crate::primitives::{Base, ImuSample, Rotation, Steps, Tip};
use crate::simulation::plant::PlantError;

/// Answer to one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply {
    /// A sample, if the sensor had one.
    pub imu: Option<ImuSample>,
    /// A sample of the IMU on the base, if there is one and it had one.
    pub base_imu: Option<ImuSample>,
    /// True tip orientation relative to the start, for scoring.
    pub truth: Option<Rotation<Base, Tip>>,
}

/// A simulated machine.
pub trait World: Send {
    /// Description of the machine.
    fn info(&self) -> &MachineInfo;
    /// Holds the counts for one period.
    ///
    /// # Errors
    /// [`MachineError`] if a plant program ends, does not answer or violates the protocol.
    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError>;
}

impl<W: World + ?Sized> World for &mut W {
    fn info(&self) -> &MachineInfo {
        (**self).info()
    }
    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError> {
        (**self).step(steps)
    }
}

impl From<PlantError> for MachineError {
    fn from(e: PlantError) -> Self {
        Self::Plant(e.to_string())
    }
}
