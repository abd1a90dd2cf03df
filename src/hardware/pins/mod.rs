//! The pins of the three drivers behind one small trait, and its backends.
//!
//! | backend | access | cost of one change of levels |
//! |---|---|---|
//! | [`rppal`] | mapped registers of a Raspberry Pi | one store per line |
//! | [`cdev`] | GPIO character device of any Linux board | one ioctl for all lines |
//! | [`mock`] | none; records every edge with its time | one push |
//!
//! [`hal::HalPins`] makes a backend of any set of `embedded-hal` pins; the `rppal` backend uses it.
//! [`map`] applies polarity: above it levels are logical, below it they are voltages.

pub mod cdev;
pub mod config;
pub mod hal;
pub mod map;
pub mod mock;
#[cfg(feature = "hw")]
pub mod rppal;
mod uapi;

pub use config::{Backend, ChannelPins, InputPin, PinsConfig, Pull};
pub use mock::MockPins;

use crate::motion::lines::{Inputs, Levels};

/// Why the pins cannot be opened or used. Every variant leads to exit code 3.
#[derive(Debug, thiserror::Error)]
pub enum PinError {
    /// There is no such device file.
    #[error(
        "no GPIO chip at {path}: list the chips with `ls /dev/gpiochip*` and set pins.chip (or pins.backend = \"rppal\" on a Raspberry Pi)"
    )]
    NoChip {
        /// Path of the device file.
        path: String,
    },
    /// The file is not a GPIO chip, or the kernel does not provide version 2 of the interface.
    #[error("{path} is not a GPIO chip with line interface version 2 (Linux 5.10 or newer): set pins.chip to a /dev/gpiochip*")]
    NotAChip {
        /// Path of the device file.
        path: String,
    },
    /// The chip has fewer lines.
    #[error("{chip} has no line {pin}, only 0 to {}: correct the pin numbers in the board file", .lines.saturating_sub(1))]
    NoLine {
        /// Chip path or board name.
        chip: String,
        /// Line number.
        pin: u32,
        /// Number of lines of the chip.
        lines: u32,
    },
    /// Another consumer holds a line.
    #[error("GPIO {pin} is in use{}: stop that program or driver, or choose another pin", .by.as_ref().map_or(String::new(), |b| format!(" by \"{b}\"")))]
    Busy {
        /// Line number.
        pin: u32,
        /// Name of the consumer, if known.
        by: Option<String>,
    },
    /// The device may not be opened.
    #[error(
        "no permission for {path}: add this user to the group gpio (`sudo usermod -aG gpio $USER`, then log in again) or run as the service"
    )]
    PermissionDenied {
        /// Path of the device file.
        path: String,
    },
    /// `rppal` does not support this board.
    #[error("this is not a Raspberry Pi that rppal supports: set pins.backend = \"cdev\"")]
    UnknownModel,
    /// The program was built without the feature `hw`.
    #[error("this program was built without hardware support: build with `--features hw`")]
    NotBuilt,
    /// EN does not follow its output.
    #[error(
        "EN on GPIO {pin} stays {} when driven {}: look for a short, a missing driver supply or a second program on the line, and do not rely on the emergency stop until this is repaired",
        level(!.driven_high),
        level(*.driven_high)
    )]
    EnableStuck {
        /// Line number.
        pin: u32,
        /// The level that was written is high.
        driven_high: bool,
    },
    /// A read or write failed.
    #[error("GPIO {what} failed: {source}; check the wiring and the kernel log (`dmesg | tail`)")]
    Io {
        /// The operation.
        what: &'static str,
        /// The error of the system call.
        source: std::io::Error,
    },
    /// A pin of an `embedded-hal` implementation failed.
    #[error("GPIO {what} failed: {why}; check the wiring")]
    Pin {
        /// The operation.
        what: &'static str,
        /// The message of the implementation.
        why: String,
    },
}

fn level(high: bool) -> &'static str {
    if high { "high" } else { "low" }
}

/// Output and input lines of the three drivers.
pub trait Pins: Send {
    /// Brings the lines to these levels, touching only those that differ from the last call.
    /// Does not allocate unless it fails.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`]; it is then unknown which lines have changed.
    fn write(&mut self, levels: &Levels) -> Result<(), PinError>;

    /// Whether an earlier program left the drivers energised and they still are. Backends that cannot
    /// read this take the lines over released.
    fn found_energised(&self) -> bool {
        false
    }

    /// Reads the EN lines back and compares them with the last write. Backends that cannot read them
    /// back accept them.
    ///
    /// # Errors
    /// [`PinError::EnableStuck`], or a failed read.
    fn check_enable(&mut self) -> Result<(), PinError> {
        Ok(())
    }

    /// Reads the input lines. Lines that are not wired read as not pressed.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`].
    fn read(&mut self) -> Result<Inputs, PinError>;
}

impl Pins for Box<dyn Pins> {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        (**self).write(levels)
    }
    fn found_energised(&self) -> bool {
        (**self).found_energised()
    }
    fn check_enable(&mut self) -> Result<(), PinError> {
        (**self).check_enable()
    }
    fn read(&mut self) -> Result<Inputs, PinError> {
        (**self).read()
    }
}

/// Opens the configured backend and requests all lines: STEP at its resting level, microstep levels set
/// for `microsteps` (1, 2, 4, 8 or 16), and the drivers released. Only `rppal` can find the drivers
/// energised; it leaves them so.
///
/// # Errors
/// [`OpenError`].
pub fn open(config: &PinsConfig, microsteps: u32) -> Result<Box<dyn Pins>, OpenError> {
    config.validate()?;
    let map = map::LineMap::new(config, microsteps)?;
    match config.backend {
        Backend::Mock => Ok(Box::new(MockPins::new(map, 0))),
        Backend::Cdev => Ok(Box::new(cdev::CdevPins::open(&config.chip, map)?)),
        #[cfg(feature = "hw")]
        Backend::Rppal => Ok(Box::new(rppal::open(map)?)),
        #[cfg(not(feature = "hw"))]
        Backend::Rppal => Err(OpenError::Pin(PinError::NotBuilt)),
    }
}

/// Why [`open`] failed: an invalid board file (exit code 2) or the hardware (exit code 3).
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] crate::primitives::check::Invalid),
    /// The hardware.
    #[error(transparent)]
    Pin(#[from] PinError),
}
