//! What can go wrong between the bus and a sample, as values that carry their advice.

use super::Part;
use crate::estimation::fusion::health::ReadFault;
use embedded_hal::i2c::ErrorKind;

/// A reading that did not come, or cannot be trusted.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ImuError {
    /// The address was not acknowledged.
    #[error("{part} at {address:#04x} does not answer (no acknowledge): {}", self.advice())]
    Nack {
        /// Which chip was asked.
        part: Part,
        /// Its 7-bit address.
        address: u8,
    },
    /// The transfer broke off: fewer bytes than asked, or a tail of 0xFF from a bus nobody drives.
    #[error("{part} at {address:#04x} sent {have} of {want} bytes: {}", self.advice())]
    ShortRead {
        /// Which chip was asked.
        part: Part,
        /// Its 7-bit address.
        address: u8,
        /// Bytes that look real.
        have: usize,
        /// Bytes asked for.
        want: usize,
    },
    /// The bus failed: arbitration lost, timeout, a line held down.
    #[error("bus fault ({kind:?}) while talking to {part} at {address:#04x}: {}", self.advice())]
    Bus {
        /// Which chip was asked.
        part: Part,
        /// Its 7-bit address.
        address: u8,
        /// What the bus driver reported.
        kind: ErrorKind,
    },
    /// Another chip answers at this address.
    #[error("WHO_AM_I at {address:#04x} is {have:#04x}, a {part} has {want:#04x}: {}", self.advice())]
    WrongId {
        /// The chip that was expected.
        part: Part,
        /// The 7-bit address.
        address: u8,
        /// The identity read.
        have: u8,
        /// The identity of the part.
        want: u8,
    },
    /// A setting is no longer what was written: the chip has restarted.
    #[error("{part} register {register:#04x} is {have:#04x}, was set to {want:#04x}: {}", self.advice())]
    ResetToDefaults {
        /// Which chip.
        part: Part,
        /// The register that gave it away.
        register: u8,
        /// What it holds.
        have: u8,
        /// What was written.
        want: u8,
    },
    /// The chip did not finish something in its guaranteed time.
    #[error("{part} did not finish {what} within {limit_ms} ms: {}", self.advice())]
    Timeout {
        /// Which chip.
        part: Part,
        /// What was waited for.
        what: &'static str,
        /// How long, ms.
        limit_ms: u32,
    },
    /// `read` was called before a successful `init`, or after a restart was found.
    #[error("{part} is not set up: {}", self.advice())]
    NotReady {
        /// Which chip.
        part: Part,
    },
}

impl ImuError {
    /// What a person, or the supervisor, should do.
    #[must_use]
    pub fn advice(&self) -> &'static str {
        match self {
            Self::Nack { .. } => "check plug, 3.3 V supply and `imu.address` (`i2cdetect -y 1` shows who answers)",
            Self::ShortRead { .. } => "look for a loose contact or a cable beyond 1.2 m at 400 kHz",
            Self::Bus { .. } => "power-cycle the IMU, then look for a short or a missing pull-up on SDA and SCL",
            Self::WrongId { .. } => "set `imu.part` and `imu.address` to the part that is fitted",
            Self::ResetToDefaults { .. } => "its supply dipped: set it up again and check the 3.3 V under motor load",
            Self::Timeout { .. } => "power-cycle the IMU; if it stays so, replace it",
            Self::NotReady { .. } => "call init first, and again after every restart of the chip",
        }
    }

    /// The fault as the health judge counts it.
    #[must_use]
    pub fn fault(&self) -> ReadFault {
        match self {
            Self::Nack { .. } | Self::Timeout { .. } => ReadFault::Nack,
            Self::ShortRead { .. } => ReadFault::ShortRead,
            Self::Bus { .. } => ReadFault::Bus,
            Self::WrongId { .. } => ReadFault::WrongId,
            Self::ResetToDefaults { .. } | Self::NotReady { .. } => ReadFault::BrownOut,
        }
    }
}

/// A setting of the `[imu]` table that the part does not have.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("`imu.{field}` = {value} does not exist on the {part}: write {allowed}")]
pub struct ConfigError {
    /// The part configured.
    pub part: Part,
    /// Name of the field.
    pub field: &'static str,
    /// What was written.
    pub value: f64,
    /// What may be written.
    pub allowed: &'static str,
}
