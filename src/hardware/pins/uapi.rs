//! The GPIO character device, version 2 (`linux/gpio.h`), through the crate `gpiocdev-uapi`.

use crate::hardware::pins::config::Pull;
use gpiocdev_uapi::v2::{
    self, LineConfig, LineFlags, LineRequest, LineValues, Offsets, get_chip_info,
};
use gpiocdev_uapi::{Errno, Error, NUM_LINES_MAX};
use std::fs::{File, OpenOptions};
use std::io;

/// Most lines in one request.
pub const LINES_MAX: usize = NUM_LINES_MAX;
/// Consumer name that `gpioinfo` shows for the lines.
const CONSUMER: &str = "retroflex";

/// A request for lines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// Line offsets; line i is bit i.
    pub offsets: Vec<u32>,
    /// Direction.
    pub kind: RequestKind,
}

/// Direction of the lines of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RequestKind {
    /// Outputs with their initial voltages; bit i is line i, 1 is high.
    Outputs(u64),
    /// Inputs with the pull resistor of each line.
    Inputs(Vec<Pull>),
    /// Whatever they are: only to read them.
    AsIs,
}

/// State of a line.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LineState {
    /// Name of the consumer that holds it; `None` if it is free or the consumer has no name.
    pub consumer: Option<String>,
    /// It is an output.
    pub output: bool,
}

/// What a chip says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChipInfo {
    /// Number of lines.
    pub lines: u32,
    /// Name of the hardware: unlike the number of the device file, it does not depend on the kernel.
    pub label: String,
}

/// The kernel interface; a trait, so that tests can do without a chip.
pub trait Kernel: Send {
    /// An open chip.
    type Chip: Send;
    /// A granted request.
    type Lines: Send;

    /// Opens a chip.
    ///
    /// # Errors
    /// The error of the system call.
    fn open(&self, path: &str) -> io::Result<(Self::Chip, ChipInfo)>;

    /// Requests lines.
    ///
    /// # Errors
    /// The error of the system call.
    fn request(&self, chip: &Self::Chip, request: &Request) -> io::Result<Self::Lines>;

    /// The state of a line.
    ///
    /// # Errors
    /// The error of the system call.
    fn state(&self, chip: &Self::Chip, offset: u32) -> io::Result<LineState>;

    /// Sets the lines of `mask` to `bits`.
    ///
    /// # Errors
    /// The error of the system call.
    fn set(&self, lines: &Self::Lines, mask: u64, bits: u64) -> io::Result<()>;

    /// Reads the lines of `mask`.
    ///
    /// # Errors
    /// The error of the system call.
    fn get(&self, lines: &Self::Lines, mask: u64) -> io::Result<u64>;
}

/// The running kernel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Uapi;

impl Kernel for Uapi {
    type Chip = File;
    type Lines = File;

    fn open(&self, path: &str) -> io::Result<(File, ChipInfo)> {
        let chip = OpenOptions::new().read(true).write(true).open(path)?;
        let info = get_chip_info(&chip).map_err(cause)?;
        let label = info.label.as_os_str().to_string_lossy().into_owned();
        let lines = info.num_lines;
        Ok((chip, ChipInfo { lines, label }))
    }

    fn request(&self, chip: &File, request: &Request) -> io::Result<File> {
        v2::get_line(chip, line_request(request)).map_err(cause)
    }

    fn state(&self, chip: &File, offset: u32) -> io::Result<LineState> {
        let info = v2::get_line_info(chip, offset).map_err(cause)?;
        let consumer = (!info.consumer.is_empty())
            .then(|| info.consumer.as_os_str().to_string_lossy().into_owned());
        Ok(LineState {
            consumer,
            output: info.flags.contains(LineFlags::OUTPUT),
        })
    }

    fn set(&self, lines: &File, mask: u64, bits: u64) -> io::Result<()> {
        v2::set_line_values(lines, &LineValues { bits, mask }).map_err(cause)
    }

    fn get(&self, lines: &File, mask: u64) -> io::Result<u64> {
        let mut values = LineValues { bits: 0, mask };
        v2::get_line_values(lines, &mut values).map_err(cause)?;
        Ok(values.bits & mask)
    }
}

/// The error of the system call.
fn cause(error: Error) -> io::Error {
    match error {
        Error::Os(Errno(number)) => io::Error::from_raw_os_error(number),
        other => io::Error::other(other.to_string()),
    }
}

/// The request in the layout of the kernel.
fn line_request(request: &Request) -> LineRequest {
    let mut config = LineConfig::default();
    match &request.kind {
        RequestKind::Outputs(bits) => {
            config.flags = LineFlags::OUTPUT;
            config.add_values(&LineValues {
                bits: *bits,
                mask: u64::MAX >> (LINES_MAX - request.offsets.len()),
            });
        }
        RequestKind::Inputs(pulls) => {
            config.flags = LineFlags::INPUT;
            for (pull, bias) in [
                (Pull::Up, LineFlags::BIAS_PULL_UP),
                (Pull::Down, LineFlags::BIAS_PULL_DOWN),
                (Pull::Off, LineFlags::BIAS_DISABLED),
            ] {
                let mask = pulls
                    .iter()
                    .enumerate()
                    .filter(|(_, p)| **p == pull)
                    .fold(0, |m, (i, _)| m | 1 << i);
                if mask != 0 {
                    config.add_flags(LineFlags::INPUT | bias, mask);
                }
            }
        }
        RequestKind::AsIs => {}
    }
    let (offsets, num_lines) = (
        Offsets::from_slice(&request.offsets),
        request.offsets.len() as u32,
    );
    LineRequest {
        offsets,
        num_lines,
        config,
        consumer: CONSUMER.into(),
        ..LineRequest::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gpiocdev_uapi::v2::LineAttributeValue;

    #[test]
    fn outputs_have_their_levels_from_the_request_on() {
        let raw = line_request(&Request {
            offsets: vec![17, 5, 26],
            kind: RequestKind::Outputs(0b010),
        });
        assert_eq!(
            (raw.num_lines, &raw.offsets.0[..3], raw.config.flags),
            (3, &[17, 5, 26][..], LineFlags::OUTPUT)
        );
        let a = raw.config.attr(0);
        assert_eq!(
            (raw.config.num_attrs, a.attr.to_value(), a.mask),
            (1, Some(LineAttributeValue::Values(0b010)), 0b111)
        );
        assert_eq!(raw.consumer.as_os_str(), "retroflex");
    }

    #[test]
    fn a_request_for_inputs_contains_their_pull_resistors() {
        let pulls = vec![Pull::Up, Pull::Off, Pull::Up, Pull::Down];
        let raw = line_request(&Request {
            offsets: vec![1, 2, 3, 4],
            kind: RequestKind::Inputs(pulls),
        });
        let got: Vec<_> = (0..3)
            .map(|i| (raw.config.attr(i).attr.to_value(), raw.config.attr(i).mask))
            .collect();
        let input = |bias| Some(LineAttributeValue::Flags(LineFlags::INPUT | bias));
        assert_eq!(
            got,
            [
                (input(LineFlags::BIAS_PULL_UP), 0b0101),
                (input(LineFlags::BIAS_PULL_DOWN), 0b1000),
                (input(LineFlags::BIAS_DISABLED), 0b0010)
            ]
        );
        assert_eq!(
            (raw.config.num_attrs, raw.config.flags),
            (3, LineFlags::INPUT)
        );
    }
}
