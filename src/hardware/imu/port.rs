//! Register access to one chip on a bus: the transfers that every driver needs.

use super::{ChipId, ImuError, Part};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{Error, ErrorKind, I2c};

/// A chip at an address.
#[derive(Debug, Clone, Copy)]
pub(super) struct Port {
    pub part: Part,
    pub address: u8,
}

impl Port {
    /// Reads `out.len()` registers from `register` on, in one transaction with a repeated start.
    pub fn read<I: I2c>(&self, bus: &mut I, register: u8, out: &mut [u8]) -> Result<(), ImuError> {
        let want = out.len();
        bus.write_read(self.address, &[register], out)
            .map_err(|e| self.fault(e.kind(), want))
    }

    /// Reads one register.
    pub fn get<I: I2c>(&self, bus: &mut I, register: u8) -> Result<u8, ImuError> {
        let mut out = [0];
        self.read(bus, register, &mut out)?;
        Ok(out[0])
    }

    /// Writes one register.
    pub fn set<I: I2c>(&self, bus: &mut I, register: u8, value: u8) -> Result<(), ImuError> {
        bus.write(self.address, &[register, value])
            .map_err(|e| self.fault(e.kind(), 0))
    }

    /// Checks the identity register.
    pub fn identify<I: I2c>(
        &self,
        bus: &mut I,
        register: u8,
        want: u8,
    ) -> Result<ChipId, ImuError> {
        let have = self.get(bus, register)?;
        if have == want {
            Ok(ChipId {
                part: self.part,
                address: self.address,
                id: have,
            })
        } else {
            Err(ImuError::WrongId {
                part: self.part,
                address: self.address,
                have,
                want,
            })
        }
    }

    /// Compares consecutive registers with their values, each under a mask.
    pub fn check<I: I2c>(&self, bus: &mut I, from: u8, want: &[(u8, u8)]) -> Result<(), ImuError> {
        let mut have = [0; 8];
        let n = want.len().min(have.len());
        self.read(bus, from, &mut have[..n])?;
        for (register, (have, &(want, mask))) in (from..).zip(have.iter().zip(want)) {
            if have & mask != want & mask {
                return Err(ImuError::ResetToDefaults {
                    part: self.part,
                    register,
                    have: *have,
                    want,
                });
            }
        }
        Ok(())
    }

    /// Polls a register every millisecond until `mask` is clear. A missing acknowledge counts as busy,
    /// because a chip may not acknowledge during its reset.
    pub fn wait_clear<I: I2c>(
        &self,
        bus: &mut I,
        delay: &mut dyn DelayNs,
        (register, mask): (u8, u8),
        what: &'static str,
        limit_ms: u32,
    ) -> Result<(), ImuError> {
        let mut last = ImuError::Timeout {
            part: self.part,
            what,
            limit_ms,
        };
        for _ in 0..limit_ms {
            delay.delay_ms(1);
            match self.get(bus, register) {
                Ok(value) if value & mask == 0 => return Ok(()),
                Ok(_) => {
                    last = ImuError::Timeout {
                        part: self.part,
                        what,
                        limit_ms,
                    }
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// The error for a failed transfer of `want` bytes.
    pub fn fault(&self, kind: ErrorKind, want: usize) -> ImuError {
        let (part, address) = (self.part, self.address);
        match kind {
            ErrorKind::NoAcknowledge(_) => ImuError::Nack { part, address },
            ErrorKind::Overrun => ImuError::ShortRead {
                part,
                address,
                have: 0,
                want,
            },
            _ => ImuError::Bus {
                part,
                address,
                kind,
            },
        }
    }

    /// The error for a reading whose tail is 0xFF because the bus was no longer driven.
    pub fn short(&self, bytes: &[u8]) -> ImuError {
        let have = bytes.iter().rposition(|b| *b != 0xFF).map_or(0, |i| i + 1);
        ImuError::ShortRead {
            part: self.part,
            address: self.address,
            have,
            want: bytes.len(),
        }
    }
}
