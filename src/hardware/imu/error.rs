//! Errors between the bus and a sample, each with a remedy.

use super::{Chip, Part};
use crate::primitives::ReadFault;
use embedded_hal::i2c::ErrorKind;

/// A failed or invalid reading.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ImuError {
    /// The address was not acknowledged.
    #[error("{0} does not answer (no acknowledge): {advice}", advice = self.advice())]
    Nack(Chip),
    /// The transfer ended early: too few bytes, or a tail of 0xFF from an undriven bus.
    #[error("{chip} sent {have} of {want} bytes: {}", self.advice())]
    ShortRead {
        /// The chip addressed.
        chip: Chip,
        /// Valid bytes.
        have: usize,
        /// Bytes requested.
        want: usize,
    },
    /// The bus failed, with the error of its driver: arbitration lost, timeout, a line held down.
    #[error("bus fault ({1:?}) in a transfer with {0}: {advice}", advice = self.advice())]
    Bus(Chip, ErrorKind),
    /// Another part answers at this address.
    #[error(
        "WHO_AM_I at {:#04x} is {have:#04x}, that of the {} is {want:#04x}: {}",
        .chip.address, .chip.part, self.advice()
    )]
    WrongId {
        /// The expected chip.
        chip: Chip,
        /// Identity that was read.
        have: u8,
        /// Identity of the part.
        want: u8,
    },
    /// A setting has lost its value: the chip has restarted.
    #[error("{part} register {register:#04x} is {have:#04x} instead of {want:#04x}: {}", self.advice())]
    ResetToDefaults {
        /// The chip.
        part: Part,
        /// The register that differs.
        register: u8,
        /// Its content.
        have: u8,
        /// The value written.
        want: u8,
    },
    /// The chip did not complete an operation within its guaranteed time.
    #[error("{part} did not complete {what} within {limit_ms} ms: {}", self.advice())]
    Timeout {
        /// The chip.
        part: Part,
        /// The operation.
        what: &'static str,
        /// The guaranteed time, ms.
        limit_ms: u32,
    },
    /// `read` was called before a successful `init`, or after a restart.
    #[error("{0} is not initialised: {advice}", advice = self.advice())]
    NotReady(Part),
}

impl ImuError {
    /// The remedy.
    pub fn advice(&self) -> &'static str {
        const AK: Part = Part::Ak09916;
        match self {
            Self::Nack(Chip { part: AK, .. })
            | Self::Timeout { part: AK, .. }
            | Self::WrongId {
                chip: Chip { part: AK, .. },
                ..
            } => {
                "the magnetometer inside the chip is dead, or the chip is a copy without one: fit another"
            }
            Self::Nack(_) => {
                "check the plug, the 3.3 V supply and `imu.chip.address` (`i2cdetect -y 1` lists the addresses that answer)"
            }
            Self::ShortRead { .. } => {
                "look for a loose contact, or a cable longer than 1.2 m at 400 kHz"
            }
            Self::Bus(..) => {
                "cycle the power of the IMU, then look for a short or a missing pull-up on SDA and SCL"
            }
            Self::WrongId { have: 0x00, .. } => {
                "nothing but zeros comes back: check the supply of the chip, and SDA for a short to ground"
            }
            Self::WrongId { have: 0xFF, .. } => {
                "nobody drives the data line: check the plug and the address"
            }
            Self::WrongId {
                have: 0x68 | 0x70 | 0x71 | 0x73 | 0x75,
                ..
            } => {
                "this is an MPU-6000, 6500, 9250 or 9255, which shops sell as an ICM-20948 and which is not supported: fit one of the parts in docs/hardware.md and set `imu.chip.part` to it"
            }
            Self::WrongId { .. } => {
                "another part is fitted: set `imu.chip.part` and `imu.chip.address` to it if it is one of those in docs/hardware.md, else fit one of them"
            }
            Self::ResetToDefaults { .. } => {
                "its supply dipped, and it is set up again: check the 3.3 V supply under motor load"
            }
            Self::Timeout { .. } => "cycle the power of the IMU; if the error persists, replace it",
            Self::NotReady(_) => "it is set up again: if that does not help, cycle its power",
        }
    }

    /// The corresponding fault of the health monitor.
    pub fn fault(&self) -> ReadFault {
        match self {
            Self::Nack(_) | Self::Timeout { .. } => ReadFault::Nack,
            Self::ShortRead { .. } => ReadFault::ShortRead,
            Self::Bus(..) => ReadFault::Bus,
            Self::WrongId { .. } => ReadFault::WrongId,
            Self::ResetToDefaults { .. } | Self::NotReady(_) => ReadFault::BrownOut,
        }
    }
}
