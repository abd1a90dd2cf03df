//! Space on the disk.

use std::ffi::CString;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// Bytes of so many MiB.
pub fn mib(n: f64) -> u64 {
    (n * 1024.0 * 1024.0) as u64
}

/// Bytes of the file system that an ordinary user may still use.
///
/// # Errors
/// The operating system's.
#[allow(unsafe_code)]
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    let path = CString::new(path.as_os_str().as_bytes())?;
    let mut stat = std::mem::MaybeUninit::<libc::statvfs>::uninit();
    // SAFETY: the path ends in a zero, and `stat` is written in full when the call succeeds
    let stat = unsafe {
        if libc::statvfs(path.as_ptr(), stat.as_mut_ptr()) != 0 {
            return Err(io::Error::last_os_error());
        }
        stat.assume_init()
    };
    #[allow(clippy::useless_conversion, reason = "narrower on computers of 32 bits")]
    Ok(u64::from(stat.f_bavail) * u64::from(stat.f_frsize))
}
