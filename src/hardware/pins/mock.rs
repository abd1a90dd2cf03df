//! Lines without hardware, for `bench rt` and boards with `pins.backend = "mock"`.

use crate::hardware::pins::PinError;
use crate::hardware::pins::interface::Lines;

/// Lines that take every write; every input is low.
pub(super) struct NoLines;

impl Lines for NoLines {
    fn set(&mut self, _: u64, _: u64) -> Result<(), PinError> {
        Ok(())
    }
    fn outputs(&mut self, _: u64) -> Result<Option<u64>, PinError> {
        Ok(None)
    }
    fn inputs(&mut self) -> Result<u64, PinError> {
        Ok(0)
    }
}
