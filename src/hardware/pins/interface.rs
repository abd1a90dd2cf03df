//! The trait that every backend implements.

use super::PinError;
use crate::motion::{Inputs, Levels};

/// Output and input lines of the three drivers.
pub trait Pins: Send {
    /// Brings the lines to these levels, touching only those that differ from the last call.
    /// Does not allocate unless it fails.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`]; it is then unknown which lines have changed.
    fn write(&mut self, levels: &Levels) -> Result<(), PinError>;

    /// Whether an earlier program left the drivers energised and they still are; they were then taken over so. Backends
    /// that cannot read this take the lines over released.
    fn found_energised(&self) -> bool {
        false
    }

    /// Reads the EN lines back and compares them with the last write. Backends that cannot read them
    /// back accept them.
    ///
    /// # Errors
    /// [`PinError::EnableStuck`], or a failed read.
    fn check_enable(&mut self) -> Result<(), PinError> {
        Ok(())
    }

    /// Reads the input lines. Lines that are not wired read as not pressed.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`].
    fn read(&mut self) -> Result<Inputs, PinError>;
}

impl Pins for Box<dyn Pins> {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        (**self).write(levels)
    }
    fn found_energised(&self) -> bool {
        (**self).found_energised()
    }
    fn check_enable(&mut self) -> Result<(), PinError> {
        (**self).check_enable()
    }
    fn read(&mut self) -> Result<Inputs, PinError> {
        (**self).read()
    }
}
