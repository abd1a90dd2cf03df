//! Pins without hardware, for `bench rt` and boards with `pins.backend = "mock"`.

use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::{PinError, Pins};
use crate::motion::{Inputs, Levels};

/// Pins that take every write; the voltage of every input of the map is low.
#[derive(Debug)]
pub struct MockPins(pub LineMap);

impl Pins for MockPins {
    fn write(&mut self, _: &Levels) -> Result<(), PinError> {
        Ok(())
    }

    fn read(&mut self) -> Result<Inputs, PinError> {
        Ok(self.0.inputs_from(0))
    }
}
