//! The pins that the step thread drives, and the lines that a backend gives them.

use super::PinError;
use super::map::LineMap;
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

/// The lines of a backend as words of voltages: bit i is line i of the [`LineMap`], 1 is high.
pub trait Lines: Send {
    /// Sets the outputs of `mask` to `bits`. Does not allocate unless it fails.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`].
    fn set(&mut self, mask: u64, bits: u64) -> Result<(), PinError>;

    /// Reads the outputs of `mask` back; `None` where that is not possible.
    ///
    /// # Errors
    /// [`PinError::Io`].
    fn outputs(&mut self, mask: u64) -> Result<Option<u64>, PinError>;

    /// Reads the inputs.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`].
    fn inputs(&mut self) -> Result<u64, PinError>;
}

/// Lines without hardware: they take every write, and every input is low.
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

/// The lines of a board on any backend.
pub struct BoardPins {
    map: LineMap,
    lines: Box<dyn Lines>,
    /// Voltages of the last write.
    bits: u64,
    found_energised: bool,
}

impl BoardPins {
    /// Takes lines with all outputs at [`LineMap::first_bits`].
    pub(super) fn new(map: LineMap, lines: impl Lines + 'static, energised: bool) -> Self {
        Self {
            bits: map.first_bits(energised),
            map,
            lines: Box::new(lines),
            found_energised: energised,
        }
    }
}

impl Pins for BoardPins {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        let bits = self.map.output_bits(levels);
        let mask = bits ^ self.bits;
        if mask != 0 {
            self.lines.set(mask, bits)?;
            self.bits = bits;
        }
        Ok(())
    }

    fn found_energised(&self) -> bool {
        self.found_energised
    }

    fn check_enable(&mut self) -> Result<(), PinError> {
        if self.map.enable == 0 {
            return Ok(());
        }
        let found = self.lines.outputs(self.map.enable)?;
        found.map_or(Ok(()), |found| self.map.compare_enable(self.bits, found))
    }

    fn read(&mut self) -> Result<Inputs, PinError> {
        Ok(self.map.inputs_from(self.lines.inputs()?))
    }
}
