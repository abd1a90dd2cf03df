//! Space on the disk.

use std::fs::File;
use std::io;
use std::path::Path;

/// Bytes of so many MiB.
#[must_use]
pub fn mib(n: f64) -> u64 {
    (n * 1024.0 * 1024.0) as u64
}

/// Bytes of the file system that an ordinary user may still use.
///
/// # Errors
/// The operating system's.
#[allow(unsafe_code)]
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    use std::os::fd::AsRawFd;
    let file = File::open(path)?;
    let mut stat = std::mem::MaybeUninit::<libc::statvfs>::uninit();
    // SAFETY: the descriptor is open, and `stat` is written in full when the call succeeds
    let stat = unsafe {
        if libc::fstatvfs(file.as_raw_fd(), stat.as_mut_ptr()) != 0 {
            return Err(io::Error::last_os_error());
        }
        stat.assume_init()
    };
    #[allow(clippy::useless_conversion, reason = "narrower on computers of 32 bits")]
    Ok(u64::from(stat.f_bavail) * u64::from(stat.f_frsize))
}
