//! The pins of the three drivers behind one small trait, and its backends.
//!
//! | backend | what | one change of levels costs |
//! |---|---|---|
//! | [`rppal`] | registers of the Raspberry Pi, mapped | one store a line |
//! | [`cdev`] | GPIO character device of any Linux board | one ioctl for all lines |
//! | [`mock`] | none: records every edge with its time | a push |
//!
//! [`hal::HalPins`] makes a backend of any set of `embedded-hal` pins; `rppal` is one use of it.
//! Polarity is settled in [`map`]: above it a level means something, below it is a voltage.

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

use crate::motion::lines::Inputs;
use crate::motion::lines::Levels;

/// Why the pins cannot be had, or not be used. All of these are exit code 3.
#[derive(Debug, thiserror::Error)]
pub enum PinError {
    /// There is no such device file.
    #[error(
        "no GPIO chip at {path}: list the chips with `ls /dev/gpiochip*` and set pins.chip (or pins.backend = \"rppal\" on a Raspberry Pi)"
    )]
    NoChip {
        /// The path tried.
        path: String,
    },
    /// The file is there but is no GPIO chip, or its kernel speaks no version 2 of the interface.
    #[error("{path} is not a GPIO chip with line interface version 2 (Linux 5.10 or newer): set pins.chip to a /dev/gpiochip*")]
    NotAChip {
        /// The path tried.
        path: String,
    },
    /// The chip has fewer lines.
    #[error("{chip} has no line {pin}, only 0 to {}: correct the pin numbers in the board file", .lines.saturating_sub(1))]
    NoLine {
        /// Chip path or board name.
        chip: String,
        /// The line wanted.
        pin: u32,
        /// How many lines there are.
        lines: u32,
    },
    /// Somebody else holds a line.
    #[error("GPIO {pin} is in use{}: stop that program or driver, or choose another pin", .by.as_ref().map_or(String::new(), |b| format!(" by \"{b}\"")))]
    Busy {
        /// The line.
        pin: u32,
        /// Who holds it, if known.
        by: Option<String>,
    },
    /// The device may not be opened.
    #[error(
        "no permission for {path}: add this user to the group gpio (`sudo usermod -aG gpio $USER`, then log in again) or run as the service"
    )]
    PermissionDenied {
        /// The device.
        path: String,
    },
    /// `rppal` does not know this board.
    #[error("this is no Raspberry Pi that rppal knows: set pins.backend = \"cdev\"")]
    UnknownModel,
    /// The program was built without the feature `hw`.
    #[error("this program was built without hardware support: build with `--features hw`")]
    NotBuilt,
    /// EN does not follow what is written to it.
    #[error(
        "EN on GPIO {pin} stays {} when driven {}: look for a short, a missing driver supply or a second program on the line, and do not rely on the emergency stop until it is mended",
        if *.wanted_high { "low" } else { "high" },
        if *.wanted_high { "high" } else { "low" }
    )]
    EnableStuck {
        /// The line.
        pin: u32,
        /// The level that was written.
        wanted_high: bool,
    },
    /// A read or write failed.
    #[error("GPIO {what} failed: {source}; check the wiring and the kernel log (`dmesg | tail`)")]
    Io {
        /// What was tried.
        what: &'static str,
        /// What the kernel said.
        source: std::io::Error,
    },
    /// A pin of an `embedded-hal` implementation failed.
    #[error("GPIO {what} failed: {why}; check the wiring")]
    Pin {
        /// What was tried.
        what: &'static str,
        /// The implementation's words.
        why: String,
    },
}

/// Output and input lines of the three drivers.
pub trait Pins: Send {
    /// Brings the lines to these levels, touching only those that differ from the last call.
    /// Allocates nothing unless it fails.
    ///
    /// # Errors
    /// [`PinError::Io`] or [`PinError::Pin`]; which lines have moved is then unknown.
    fn write(&mut self, levels: &Levels) -> Result<(), PinError>;

    /// The drivers were energised when the lines were taken over, and still are: a program before this one
    /// left them so. Pins that cannot tell were taken over released.
    fn found_energised(&self) -> bool {
        false
    }

    /// Reads the EN lines back and compares them with what was written last. Pins that cannot be read
    /// back say nothing.
    ///
    /// # Errors
    /// [`PinError::EnableStuck`], or a failed read.
    fn check_enable(&mut self) -> Result<(), PinError> {
        Ok(())
    }

    /// Reads the input lines; those that are not wired read as not pressed.
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

/// Opens the configured backend: all lines requested, STEP low, drivers released (or, through the registers of a
/// Raspberry Pi, left energised if they are found so), microstep levels
/// set for `microsteps` (1, 2, 4, 8 or 16).
///
/// # Errors
/// [`OpenError`].
pub fn open(config: &PinsConfig, microsteps: u32) -> Result<Box<dyn Pins>, OpenError> {
    config.validate()?;
    let map = map::LineMap::new(config, microsteps)?;
    match config.backend {
        Backend::Mock => Ok(Box::new(MockPins::new(map::LineMap::new(config, microsteps)?, 0))),
        Backend::Cdev => Ok(Box::new(cdev::CdevPins::open(&config.chip, map)?)),
        #[cfg(feature = "hw")]
        Backend::Rppal => Ok(Box::new(rppal::open(map)?)),
        #[cfg(not(feature = "hw"))]
        Backend::Rppal => Err(OpenError::Pin(PinError::NotBuilt)),
    }
}

/// Why [`open`] failed: a wrong board file (exit code 2) or the hardware (exit code 3).
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] crate::motion::ConfigError),
    /// The hardware.
    #[error(transparent)]
    Pin(#[from] PinError),
}
