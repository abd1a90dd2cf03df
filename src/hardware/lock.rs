//! One owner of the hardware: an exclusive lock (`flock(2)`) on the device files of the pins, taken before any device is
//! opened by whatever drives pins. The kernel releases it when the process ends, however that happens.

use std::fs::File;
use std::path::PathBuf;

/// Names of the device files through which pins can be reached, by either library.
const DEVICES: [&str; 2] = ["gpiochip", "gpiomem"];

/// The lock; dropping it releases the hardware.
#[derive(Debug)]
pub struct HardwareLock {
    _files: Vec<File>,
}

impl HardwareLock {
    /// Locks every device file of pins on this computer.
    ///
    /// # Errors
    /// The path of a device that another process has locked.
    pub fn take() -> Result<Self, PathBuf> {
        let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
        let is_pins = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            DEVICES.iter().any(|device| name.starts_with(device))
        };
        Self::of(entries.map(|entry| entry.path()).filter(is_pins))
    }

    /// Locks these files. One that cannot be opened cannot be driven either and is left out.
    ///
    /// # Errors
    /// The path of a file that another process has locked.
    pub fn of(paths: impl IntoIterator<Item = PathBuf>) -> Result<Self, PathBuf> {
        let mut files = Vec::new();
        for path in paths {
            if let Ok(file) = File::open(&path) {
                file.try_lock().map_err(|_| path)?;
                files.push(file);
            }
        }
        Ok(Self { _files: files })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hardware_has_one_owner() {
        let device = tempfile::NamedTempFile::new().unwrap();
        let paths = || [device.path().to_owned(), PathBuf::from("/no/such/device")];
        let owner = HardwareLock::of(paths()).unwrap();
        assert_eq!(HardwareLock::of(paths()).unwrap_err(), device.path());
        drop(owner);
        HardwareLock::of(paths()).unwrap();
    }
}
