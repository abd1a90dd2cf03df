//! Why pins cannot be opened or used.

use crate::primitives::Invalid;

/// Why the pins cannot be opened or used: an invalid board file (exit code 2) or the hardware (exit code 3).
#[derive(Debug, thiserror::Error)]
pub enum PinError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] Invalid),
    /// There is no such device file: its path.
    #[error(
        "no GPIO chip at {0}: list the chips with `ls /dev/gpiochip*` and set pins.chip (or pins.backend = \"rppal\" on a Raspberry Pi)"
    )]
    NoChip(String),
    /// The file is not a GPIO chip, or the kernel does not provide version 2 of the interface: its path.
    #[error(
        "{0} is not a GPIO chip with line interface version 2 (Linux 5.10 or newer): set pins.chip to a /dev/gpiochip*"
    )]
    NotAChip(String),
    /// The file is that of another chip than the board's.
    #[error(
        "{path} is the GPIO chip \"{have}\", the board's is \"{want}\": {}",
        .at.as_ref().map_or_else(
            || "no chip of this computer has that label; set pins.chip and pins.chip_label as `gpioinfo` prints them".to_owned(),
            |at| format!("set pins.chip = \"{at}\"")
        )
    )]
    OtherChip {
        /// Path that was opened.
        path: String,
        /// Its label.
        have: String,
        /// Label of the board's chip.
        want: String,
        /// Where that is, if anywhere.
        at: Option<String>,
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
    /// The device may not be opened: path of its file.
    #[error(
        "no permission for {0}: add this user to the group gpio (`sudo usermod -aG gpio $USER`, then log in again) or run as the service"
    )]
    PermissionDenied(String),
    /// The kernel has no device for the registers: its path.
    #[error("there is no {0}: set pins.backend = \"cdev\"")]
    NoRegisters(String),
    /// `rppal` does not support this board.
    #[error("this is not a Raspberry Pi that rppal supports: set pins.backend = \"cdev\"")]
    UnknownModel,
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
    /// A pin of an `embedded-hal` implementation failed: the operation, and the message of the implementation.
    #[error("GPIO {0} failed: {1}; check the wiring")]
    Pin(&'static str, String),
}

impl PinError {
    /// The error of a system call in an operation.
    pub fn io(what: &'static str) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Io { what, source }
    }
}

fn level(high: bool) -> &'static str {
    if high { "high" } else { "low" }
}
