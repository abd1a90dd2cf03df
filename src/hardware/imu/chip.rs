//! The transfers with a chip that every driver needs.

use super::{Chip, ImuError, Part};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{Error, ErrorKind, I2c};

/// A chip on its bus.
#[derive(Debug)]
pub(super) struct Device<I> {
    pub(super) bus: I,
    pub(super) chip: Chip,
}

impl<I: I2c> Device<I> {
    /// Reads `out.len()` registers from `register` on, in one transaction with a repeated start.
    pub(super) fn read(&mut self, register: u8, out: &mut [u8]) -> Result<(), ImuError> {
        let (chip, want) = (self.chip, out.len());
        let read = self.bus.write_read(chip.address, &[register], out);
        read.map_err(|e| chip.fault(e.kind(), want))
    }

    /// Reads one register.
    pub(super) fn get(&mut self, register: u8) -> Result<u8, ImuError> {
        let mut out = [0];
        self.read(register, &mut out)?;
        Ok(out[0])
    }

    /// Writes one register.
    pub(super) fn set(&mut self, register: u8, value: u8) -> Result<(), ImuError> {
        let written = self.bus.write(self.chip.address, &[register, value]);
        written.map_err(|e| self.chip.fault(e.kind(), 0))
    }

    /// Compares consecutive registers with their values, each under a mask.
    pub(super) fn check(&mut self, from: u8, want: &[(u8, u8)]) -> Result<(), ImuError> {
        let mut have = [0; 8];
        let n = want.len().min(have.len());
        self.read(from, &mut have[..n])?;
        for (register, (have, (want, mask))) in (from..).zip(have.into_iter().zip(want)) {
            if have & mask != want & mask {
                return Err(self.chip.part.reset_to_defaults(register, have, *want));
            }
        }
        Ok(())
    }

    /// Polls a register every millisecond until the bit of a reset is clear. A missing acknowledge counts as busy, because a chip may
    /// not acknowledge during its reset.
    pub(super) fn wait_for_reset(
        &mut self,
        delay: &mut dyn DelayNs,
        register: u8,
        bit: u8,
        limit_ms: u32,
    ) -> Result<(), ImuError> {
        let timeout = ImuError::Timeout {
            part: self.chip.part,
            what: "its reset",
            limit_ms,
        };
        let mut last = timeout;
        for _ in 0..limit_ms {
            delay.delay_ms(1);
            last = match self.get(register) {
                Ok(value) if value & bit == 0 => return Ok(()),
                Ok(_) => timeout,
                Err(error) => error,
            };
        }
        Err(last)
    }
}

impl Chip {
    /// Checks the content of an identity register.
    pub(super) fn identify(self, have: u8, want: u8) -> Result<(), ImuError> {
        if have == want {
            return Ok(());
        }
        Err(ImuError::WrongId {
            chip: self,
            have,
            want,
        })
    }

    /// The error for a failed transfer of `want` bytes.
    fn fault(self, kind: ErrorKind, want: usize) -> ImuError {
        match kind {
            ErrorKind::NoAcknowledge(_) => ImuError::Nack(self),
            ErrorKind::Overrun => self.sent(0, want),
            _ => ImuError::Bus(self, kind),
        }
    }

    /// The error for a reading whose tail is 0xFF because the bus was no longer driven.
    pub(super) fn short(self, bytes: &[u8]) -> ImuError {
        let have = bytes.iter().rposition(|b| *b != 0xFF).map_or(0, |i| i + 1);
        self.sent(have, bytes.len())
    }

    fn sent(self, have: usize, want: usize) -> ImuError {
        ImuError::ShortRead {
            chip: self,
            have,
            want,
        }
    }
}

impl Part {
    /// The error for a register that has lost its value.
    pub(super) fn reset_to_defaults(self, register: u8, have: u8, want: u8) -> ImuError {
        ImuError::ResetToDefaults {
            part: self,
            register,
            have,
            want,
        }
    }
}
