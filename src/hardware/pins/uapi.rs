//! The GPIO character device, version 2 (`linux/gpio.h`), through the crate `gpiocdev-uapi`.

use crate::hardware::pins::config::Pull;
use crate::hardware::pins::map::word;
use gpiocdev_uapi::v2::{
    self, ChipInfo, LineFlags, LineInfo, LineRequest, LineValues, Offsets, get_chip_info,
};
use gpiocdev_uapi::{Errno, Error, Name};
use std::fs::File;
use std::io;

/// Consumer name that `gpioinfo` shows for the lines.
const CONSUMER: &str = "retroflex";

/// The text of a name in the layout of the kernel.
pub fn text(name: &Name) -> String {
    name.as_os_str().to_string_lossy().into_owned()
}

/// A request to read lines whatever they are.
pub fn as_is(offsets: &[u32]) -> LineRequest {
    LineRequest {
        offsets: Offsets::from_slice(offsets),
        num_lines: offsets.len() as u32,
        consumer: CONSUMER.into(),
        ..LineRequest::default()
    }
}

/// A request for outputs with their initial voltages: bit i is line i, 1 is high.
pub fn outputs(offsets: &[u32], bits: u64) -> LineRequest {
    let mut request = as_is(offsets);
    request.config.flags = LineFlags::OUTPUT;
    let mask = word(offsets.iter().map(|_| true));
    request.config.add_values(&LineValues { bits, mask });
    request
}

/// A request for inputs, each with its pull resistor.
pub fn inputs(lines: &[(u32, Pull)]) -> LineRequest {
    let (offsets, pulls): (Vec<u32>, Vec<Pull>) = lines.iter().copied().unzip();
    let mut request = as_is(&offsets);
    request.config.flags = LineFlags::INPUT;
    for (pull, bias) in [
        (Pull::Up, LineFlags::BIAS_PULL_UP),
        (Pull::Down, LineFlags::BIAS_PULL_DOWN),
        (Pull::Off, LineFlags::BIAS_DISABLED),
    ] {
        let mask = word(pulls.iter().map(|p| *p == pull));
        if mask != 0 {
            request.config.add_flags(LineFlags::INPUT | bias, mask);
        }
    }
    request
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
    fn request(&self, chip: &Self::Chip, request: LineRequest) -> io::Result<Self::Lines>;

    /// The state of a line.
    ///
    /// # Errors
    /// The error of the system call.
    fn state(&self, chip: &Self::Chip, offset: u32) -> io::Result<LineInfo>;

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
        let chip = File::options().read(true).write(true).open(path)?;
        let info = get_chip_info(&chip).map_err(cause)?;
        Ok((chip, info))
    }

    fn request(&self, chip: &File, request: LineRequest) -> io::Result<File> {
        v2::get_line(chip, request).map_err(cause)
    }

    fn state(&self, chip: &File, offset: u32) -> io::Result<LineInfo> {
        v2::get_line_info(chip, offset).map_err(cause)
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

#[cfg(test)]
mod tests {
    use super::*;
    use gpiocdev_uapi::v2::LineAttributeValue;

    #[test]
    fn outputs_have_their_levels_from_the_request_on() {
        let raw = outputs(&[17, 5, 26], 0b010);
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
        let raw = inputs(&[
            (1, Pull::Up),
            (2, Pull::Off),
            (3, Pull::Up),
            (4, Pull::Down),
        ]);
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
