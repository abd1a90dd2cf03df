//! Distinguishes a missing chip from a bus fault on Linux.
//!
//! The Pi's controller (i2c-bcm2835) reports an address without acknowledge as EREMOTEIO (121) and a
//! clock line held low as ETIMEDOUT (110). `linux-embedded-hal` maps both to
//! `embedded_hal::i2c::ErrorKind::Other`, so a driver could not distinguish a pulled plug from a short.
//! [`Classified`] wraps its bus and restores the distinction (Linux fault codes,
//! Documentation/i2c/fault-codes.rst).
//!
//! The crate sends a register read as one I2C_RDWR with a repeated start, and opens the bus
//! file again whenever the address changes; each driver therefore needs a handle of its own.

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use linux_embedded_hal::i2cdev::linux::LinuxI2CError;
use linux_embedded_hal::{I2CError, I2cdev};

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

/// A bus whose errors are classified by the kernel's error number.
pub struct Classified(pub I2cdev);

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

/// The kernel's error number of a bus error, if it carries one.
fn errno(error: &I2CError) -> Option<i32> {
    match error.inner() {
        LinuxI2CError::Errno(n) => Some(*n),
        LinuxI2CError::Io(e) => e.raw_os_error(),
    }
}

impl ErrorType for Classified {
    type Error = ErrorKind;
}

impl I2c for Classified {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        let done = self.0.transaction(address, operations);
        done.map_err(|e| errno(&e).and_then(class_of).unwrap_or(e.kind()))
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
    fn the_error_number_is_recovered() {
        let raw = std::io::Error::from_raw_os_error(libc::EREMOTEIO);
        let error = I2CError::from(LinuxI2CError::Io(raw));
        assert_eq!((error.kind(), errno(&error)), (ErrorKind::Other, Some(121)));
    }
}
