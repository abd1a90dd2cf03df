//! Files of the service and space on the disk.

use crate::config::ServiceSection;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Bytes of so many MiB.
pub fn mib(n: f64) -> u64 {
    (n * 1024.0 * 1024.0) as u64
}

/// Opens a file of the state folder: its owner's alone, never through a link, and nothing but a regular file.
///
/// # Errors
/// The operating system's, or that it is another kind of file.
pub fn open(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK;
    let file = options.mode(0o600).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() {
        Ok(file)
    } else {
        Err(io::Error::other("this is no regular file"))
    }
}

/// Creates a recording, which must not exist yet, not even as a link. Its owner's group may read it.
///
/// # Errors
/// The operating system's.
pub fn create_recording(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true).mode(0o640).open(path)
}

/// Bytes of the file system that an ordinary user may still use.
///
/// # Errors
/// The operating system's.
#[allow(
    clippy::useless_conversion,
    reason = "narrower on computers of 32 bits"
)]
pub fn free_bytes(path: &Path) -> io::Result<u64> {
    let stat = nix::sys::statvfs::statvfs(path)?;
    Ok(u64::from(stat.blocks_available()) * u64::from(stat.fragment_size()))
}

/// Refuses a disk with less free space than `service.record_free_mib`.
///
/// # Errors
/// What is free, the limit and the remedy, or the operating system's.
pub fn require_free(folder: &Path, bounds: &ServiceSection) -> io::Result<()> {
    let (free, least_mib) = (free_bytes(folder)?, bounds.record_free_mib);
    if free >= mib(least_mib) {
        return Ok(());
    }
    let why = format!(
        "only {} MiB of the disk are free, and service.record_free_mib keeps {least_mib} MiB: \
         delete files, or set a smaller limit in the board file",
        free >> 20
    );
    Err(io::Error::new(io::ErrorKind::StorageFull, why))
}
