//! The pins of the three drivers behind one small trait, and its backends.
//!
//! | backend | access | cost of one change of levels |
//! |---|---|---|
//! | [`rppal`] | mapped registers of a Raspberry Pi | one store per line |
//! | [`cdev`] | GPIO character device of any Linux board | one ioctl for all lines |
//! | mock | none | none |
//!
//! The first two are equal: both take the drivers over as they find them, read EN back, and pass the same tests.
//! docs/hardware.md says when to choose which.
//!
//! [`hal`] makes a backend of any set of `embedded-hal` pins; the `rppal` backend uses it.
//! [`map`] applies polarity: above it levels are logical, below it they are voltages.

pub mod cdev;
pub mod config;
mod error;
pub mod hal;
mod interface;
pub mod map;
pub mod rppal;
#[cfg(test)]
mod tests;
mod uapi;

pub use config::{Backend, ChannelPins, InputPin, PinsConfig, Pull};
pub use error::PinError;
pub use interface::{BoardPins, Pins};

/// Opens the configured backend and requests all lines: STEP at its resting level, microstep levels set
/// for `microsteps` (1, 2, 4, 8 or 16), and the drivers released, unless they were found energised.
///
/// # Errors
/// [`PinError`].
pub fn open(config: &PinsConfig, microsteps: u32) -> Result<BoardPins, PinError> {
    config.validate()?;
    let map = map::LineMap::new(config, microsteps)?;
    Ok(match config.backend {
        Backend::Mock => BoardPins::new(map, interface::NoLines, false),
        Backend::Cdev => cdev::open(&config.chip, &config.chip_label, map)?,
        // without the device, rppal may still reach the registers through /dev/mem
        Backend::Rppal => rppal::open(map).map_err(|e| match (e, probe(config)) {
            (e @ PinError::UnknownModel, _) => e,
            (_, Err(missing @ PinError::NoRegisters(_))) => missing,
            (e, _) => e,
        })?,
    })
}

/// Opens the device that the configured backend opens, and touches no line. Returns its path, if there is one.
///
/// # Errors
/// [`PinError`]: no device, another chip, or no permission.
pub fn probe(config: &PinsConfig) -> Result<Option<&str>, PinError> {
    let path = match config.backend {
        Backend::Mock => return Ok(None),
        Backend::Cdev => {
            cdev::probe(&config.chip, &config.chip_label)?;
            return Ok(Some(&config.chip));
        }
        // the registers of the RP1, which holds the header of a Raspberry Pi 5
        Backend::Rppal => {
            let model = std::fs::read_to_string("/proc/device-tree/model").unwrap_or_default();
            let rp1 = model.contains("Raspberry Pi 5") || model.contains("Compute Module 5");
            if rp1 { "/dev/gpiomem0" } else { "/dev/gpiomem" }
        }
    };
    let opened = std::fs::File::options().read(true).write(true).open(path);
    opened.map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => PinError::NoRegisters(path.to_owned()),
        std::io::ErrorKind::PermissionDenied => PinError::PermissionDenied(path.to_owned()),
        _ => PinError::io("open")(e),
    })?;
    Ok(Some(path))
}
