//! Distinguishes a missing chip from a bus fault on Linux.
//!
//! The Pi's controller (i2c-bcm2835) reports an address without acknowledge as EREMOTEIO (121) and a
//! clock line held low as ETIMEDOUT (110). Both hardware crates map these to
//! `embedded_hal::i2c::ErrorKind::Other`, so a driver could not distinguish a pulled plug from a short.
//! [`Classified`] wraps either bus and restores the distinction (Linux fault codes,
//! Documentation/i2c/fault-codes.rst).
//!
//! `linux-embedded-hal` sends a register read as one I2C_RDWR with a repeated start, and opens the bus
//! file again whenever the address changes; each driver therefore needs a handle of its own. `rppal`
//! sends a write and a read with a stop between them. The parts keep their register pointer across the
//! stop, but another program that uses the same chip could interfere.

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

/// Longest transfer, in the kernel's unit of 10 ms. The longest regular one takes 2.4 ms at 100 kHz.
const TIMEOUT_10MS: libc::c_ulong = 2;

/// Bounds every transfer on the bus of an open bus file: the controller's driver gives up after 20 ms instead of its own
/// limit, which is a second on a Raspberry Pi, and repeats a lost arbitration once. The limits are those of the bus, not of
/// the file.
///
/// # Errors
/// The error of the system call. Transfers then have the limit of the driver.
#[allow(unsafe_code)]
pub fn bound_transfers(bus: &std::fs::File) -> std::io::Result<()> {
    const I2C_RETRIES: libc::Ioctl = 0x0701;
    const I2C_TIMEOUT: libc::Ioctl = 0x0702;
    for (number, value) in [(I2C_RETRIES, 1), (I2C_TIMEOUT, TIMEOUT_10MS)] {
        // SAFETY: both ioctls take their argument by value and touch no memory of this program.
        if unsafe { libc::ioctl(std::os::fd::AsRawFd::as_raw_fd(bus), number, value) } < 0 {
            return Err(std::io::Error::last_os_error());
        }
    }
    Ok(())
}

/// A bus error that may carry the kernel's error number.
pub trait Errno {
    /// The error number, if there is one.
    fn errno(&self) -> Option<i32>;
}

impl Errno for rppal::i2c::Error {
    fn errno(&self) -> Option<i32> {
        match self {
            Self::Io(e) => e.raw_os_error(),
            _ => None,
        }
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

/// A bus whose errors are classified by the kernel's error number.
#[derive(Debug)]
pub struct Classified<I>(pub I);

/// The class of an error number of an I²C transfer; `None` for an unspecific one.
fn class_of(errno: i32) -> Option<ErrorKind> {
    match errno {
        libc::EREMOTEIO | libc::ENXIO | libc::ENODEV => {
            Some(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown))
        }
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
    type Error = ErrorKind;
}

impl<I: I2c> I2c for Classified<I>
where
    I::Error: Errno,
{
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        self.0
            .transaction(address, operations)
            .map_err(|e| e.errno().and_then(class_of).unwrap_or(e.kind()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_acknowledge_differs_from_a_bus_fault() {
        let nack = |n| matches!(class_of(n), Some(ErrorKind::NoAcknowledge(_)));
        assert!(nack(121) && nack(6) && nack(19));
        assert_eq!(class_of(110), Some(ErrorKind::Bus));
        assert_eq!(class_of(11), Some(ErrorKind::ArbitrationLoss));
        assert_eq!(class_of(22), None);
    }

    #[test]
    fn the_error_number_of_both_crates_is_recovered() {
        let raw = || std::io::Error::from_raw_os_error(libc::EREMOTEIO);
        let rppal = rppal::i2c::Error::Io(raw());
        assert_eq!((rppal.kind(), rppal.errno()), (ErrorKind::Other, Some(121)));
        let linux = linux_embedded_hal::I2CError::from(
            linux_embedded_hal::i2cdev::linux::LinuxI2CError::Io(raw()),
        );
        assert_eq!((linux.kind(), linux.errno()), (ErrorKind::Other, Some(121)));
    }
}
