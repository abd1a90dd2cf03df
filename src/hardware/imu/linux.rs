//! Telling a missing chip from a broken bus on Linux.
//!
//! The Pi's controller (i2c-bcm2835) reports an address nobody acknowledges as EREMOTEIO (121) and a
//! clock line held low as ETIMEDOUT (110). Both hardware crates fold these into
//! `embedded_hal::i2c::ErrorKind::Other`, so a driver above could not tell a pulled plug from a
//! short. [`Classified`] wraps either bus and restores the distinction (Linux fault codes,
//! Documentation/i2c/fault-codes.rst).
//!
//! `linux-embedded-hal` sends a register read as one I2C_RDWR with a repeated start, and opens the
//! bus file anew whenever the address changes: give each driver a handle of its own. `rppal` sends a
//! write and a read with a stop between; the parts keep their register pointer over it, but another
//! program on the same chip could slip in.

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

/// A bus error that may carry the kernel's error number.
pub trait Errno {
    /// The number, if the kernel gave one.
    fn errno(&self) -> Option<i32>;
}

impl Errno for rppal::i2c::Error {
    fn errno(&self) -> Option<i32> {
        if let Self::Io(e) = self { e.raw_os_error() } else { None }
    }
}

impl Errno for linux_embedded_hal::I2CError {
    fn errno(&self) -> Option<i32> {
        use linux_embedded_hal::i2cdev::linux::LinuxI2CError;
        match self.inner() {
            LinuxI2CError::Errno(n) => Some(*n),
            LinuxI2CError::Io(e) => e.raw_os_error(),
        }
    }
}

/// A bus whose errors are sorted by the kernel's number.
#[derive(Debug)]
pub struct Classified<I>(pub I);

/// A sorted bus error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BusError {
    /// What it means.
    pub kind: ErrorKind,
    /// The kernel's number, if any.
    pub errno: Option<i32>,
}

impl Error for BusError {
    fn kind(&self) -> ErrorKind {
        self.kind
    }
}

/// The meaning of an error number on an I²C transfer; `None` for one that says nothing.
fn meaning(errno: i32) -> Option<ErrorKind> {
    match errno {
        libc::EREMOTEIO | libc::ENXIO | libc::ENODEV => Some(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown)),
        libc::ETIMEDOUT | libc::EIO | libc::EBUSY | libc::EPROTO => Some(ErrorKind::Bus),
        libc::EAGAIN => Some(ErrorKind::ArbitrationLoss),
        libc::EOVERFLOW | libc::EMSGSIZE => Some(ErrorKind::Overrun),
        _ => None,
    }
}

impl<I: I2c> ErrorType for Classified<I>
where
    I::Error: Errno,
{
    type Error = BusError;
}

impl<I: I2c> I2c for Classified<I>
where
    I::Error: Errno,
{
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        self.0.transaction(address, operations).map_err(|e| {
            let errno = e.errno();
            BusError { kind: errno.and_then(meaning).unwrap_or(e.kind()), errno }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulled_plug_is_not_a_short() {
        let nack = |n| matches!(meaning(n), Some(ErrorKind::NoAcknowledge(_)));
        assert!(nack(121) && nack(6) && nack(19));
        assert_eq!(meaning(110), Some(ErrorKind::Bus));
        assert_eq!(meaning(11), Some(ErrorKind::ArbitrationLoss));
        assert_eq!(meaning(22), None);
    }

    #[test]
    fn both_crates_hide_it_and_both_give_it_back() {
        let raw = || std::io::Error::from_raw_os_error(libc::EREMOTEIO);
        let rppal = rppal::i2c::Error::Io(raw());
        assert_eq!((rppal.kind(), rppal.errno()), (ErrorKind::Other, Some(121)));
        let linux = linux_embedded_hal::I2CError::from(linux_embedded_hal::i2cdev::linux::LinuxI2CError::Io(raw()));
        assert_eq!((linux.kind(), linux.errno()), (ErrorKind::Other, Some(121)));
    }
}
