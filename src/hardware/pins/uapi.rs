//! The five ioctls of the GPIO character device, version 2, exactly as in `linux/gpio.h`.
//!
//! Only this file of the pins needs `unsafe`. Every call passes a pointer to a fully initialised
//! `#[repr(C)]` struct of the size that the ioctl number encodes; the compiler checks the sizes, and a
//! test checks the numbers against those of the header.

#![allow(unsafe_code)]

use crate::hardware::pins::config::Pull;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};

/// Most lines in one request.
pub const LINES_MAX: usize = 64;
const ATTRS_MAX: usize = 10;
const NAME_LEN: usize = 32;
/// Consumer name that `gpioinfo` shows for the lines.
const CONSUMER: &[u8] = b"retroflex";

const FLAG_INPUT: u64 = 1 << 2;
const FLAG_OUTPUT: u64 = 1 << 3;
const FLAG_PULL_UP: u64 = 1 << 8;
const FLAG_PULL_DOWN: u64 = 1 << 9;
const FLAG_PULL_OFF: u64 = 1 << 10;
const ATTR_FLAGS: u32 = 1;
const ATTR_OUTPUT_VALUES: u32 = 2;

#[repr(C)]
#[derive(Clone, Copy)]
struct ChipInfo {
    name: [u8; NAME_LEN],
    label: [u8; NAME_LEN],
    lines: u32,
}

#[repr(C)]
#[derive(Clone, Copy)]
struct LineValues {
    bits: u64,
    mask: u64,
}

/// `gpio_v2_line_config_attribute` with its inner struct flattened: id, padding, value, mask.
#[repr(C)]
#[derive(Clone, Copy)]
struct ConfigAttribute {
    id: u32,
    padding: u32,
    value: u64,
    mask: u64,
}

#[repr(C)]
#[derive(Clone, Copy)]
struct LineConfig {
    flags: u64,
    num_attrs: u32,
    padding: [u32; 5],
    attrs: [ConfigAttribute; ATTRS_MAX],
}

#[repr(C)]
#[derive(Clone, Copy)]
struct LineRequest {
    offsets: [u32; LINES_MAX],
    consumer: [u8; NAME_LEN],
    config: LineConfig,
    num_lines: u32,
    event_buffer_size: u32,
    padding: [u32; 5],
    fd: i32,
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
struct LineInfo {
    name: [u8; NAME_LEN],
    consumer: [u8; NAME_LEN],
    offset: u32,
    num_attrs: u32,
    flags: u64,
    attrs: [[u64; 2]; ATTRS_MAX],
    padding: [u32; 4],
}

const _: () = assert!(size_of::<LineRequest>() == 592 && size_of::<LineInfo>() == 256 && size_of::<ChipInfo>() == 68);

/// Number of an ioctl on type 0xB4: direction (2 read, 3 both), size, sequence.
const fn ioctl_number<T>(direction: u32, sequence: u32) -> u32 {
    direction << 30 | (size_of::<T>() as u32) << 16 | 0xB4 << 8 | sequence
}

const GET_CHIPINFO: u32 = ioctl_number::<ChipInfo>(2, 0x01);
const GET_LINEINFO: u32 = ioctl_number::<LineInfo>(3, 0x05);
const GET_LINE: u32 = ioctl_number::<LineRequest>(3, 0x07);
const GET_VALUES: u32 = ioctl_number::<LineValues>(3, 0x0E);
const SET_VALUES: u32 = ioctl_number::<LineValues>(3, 0x0F);

/// # Safety
/// `number` must encode the size of `T`, and every bit pattern the kernel may write must be a valid `T`.
unsafe fn ioctl<T: Copy>(fd: RawFd, number: u32, argument: &mut T) -> io::Result<()> {
    // SAFETY: `argument` is a live, exclusive reference to a `T`, whose size the number encodes, so the
    // kernel reads and writes within it; the caller guarantees the rest.
    let result = unsafe { libc::ioctl(fd, number as libc::Ioctl, std::ptr::from_mut(argument)) };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

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

/// The kernel interface; a trait, so that tests can do without a chip.
pub trait Kernel: Send {
    /// An open chip.
    type Chip: Send;
    /// A granted request.
    type Lines: Send;

    /// Opens a chip and returns its number of lines.
    ///
    /// # Errors
    /// The error of the system call.
    fn open(&self, path: &str) -> io::Result<(Self::Chip, u32)>;

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
    type Lines = OwnedFd;

    fn open(&self, path: &str) -> io::Result<(File, u32)> {
        let chip = OpenOptions::new().read(true).write(true).open(path)?;
        let mut info = ChipInfo { name: [0; NAME_LEN], label: [0; NAME_LEN], lines: 0 };
        // SAFETY: GET_CHIPINFO encodes ChipInfo, which is bytes and an integer.
        unsafe { ioctl(chip.as_raw_fd(), GET_CHIPINFO, &mut info)? };
        Ok((chip, info.lines))
    }

    fn request(&self, chip: &File, request: &Request) -> io::Result<OwnedFd> {
        let mut raw = raw_request(request);
        // SAFETY: GET_LINE encodes LineRequest, which is integers and bytes.
        unsafe { ioctl(chip.as_raw_fd(), GET_LINE, &mut raw)? };
        if raw.fd < 0 {
            return Err(io::Error::from_raw_os_error(libc::EBADF));
        }
        // SAFETY: on success the kernel has opened this descriptor, and nothing else owns it.
        Ok(unsafe { OwnedFd::from_raw_fd(raw.fd) })
    }

    fn state(&self, chip: &File, offset: u32) -> io::Result<LineState> {
        let mut info = LineInfo { offset, ..LineInfo::default() };
        // SAFETY: GET_LINEINFO encodes LineInfo, which is integers and bytes.
        unsafe { ioctl(chip.as_raw_fd(), GET_LINEINFO, &mut info)? };
        let name: Vec<u8> = info.consumer.into_iter().take_while(|b| *b != 0).collect();
        let consumer = (!name.is_empty()).then(|| String::from_utf8_lossy(&name).into_owned());
        Ok(LineState { consumer, output: info.flags & FLAG_OUTPUT != 0 })
    }

    fn set(&self, lines: &OwnedFd, mask: u64, bits: u64) -> io::Result<()> {
        let mut values = LineValues { bits, mask };
        // SAFETY: SET_VALUES encodes LineValues, which is integers.
        unsafe { ioctl(lines.as_raw_fd(), SET_VALUES, &mut values) }
    }

    fn get(&self, lines: &OwnedFd, mask: u64) -> io::Result<u64> {
        let mut values = LineValues { bits: 0, mask };
        // SAFETY: GET_VALUES encodes LineValues, which is integers.
        unsafe { ioctl(lines.as_raw_fd(), GET_VALUES, &mut values)? };
        Ok(values.bits & mask)
    }
}

/// The request in the layout of the kernel.
fn raw_request(request: &Request) -> LineRequest {
    let blank = ConfigAttribute { id: 0, padding: 0, value: 0, mask: 0 };
    let mut config = LineConfig { flags: 0, num_attrs: 0, padding: [0; 5], attrs: [blank; ATTRS_MAX] };
    let mut attribute = |id, value, mask| {
        config.attrs[config.num_attrs as usize] = ConfigAttribute { id, padding: 0, value, mask };
        config.num_attrs += 1;
    };
    match &request.kind {
        RequestKind::Outputs(bits) => {
            attribute(ATTR_OUTPUT_VALUES, *bits, u64::MAX >> (LINES_MAX - request.offsets.len()));
            config.flags = FLAG_OUTPUT;
        }
        RequestKind::Inputs(pulls) => {
            for (pull, flag) in [(Pull::Up, FLAG_PULL_UP), (Pull::Down, FLAG_PULL_DOWN), (Pull::Off, FLAG_PULL_OFF)] {
                let mask = pulls.iter().enumerate().filter(|(_, p)| **p == pull).fold(0, |m, (i, _)| m | 1 << i);
                if mask != 0 {
                    attribute(ATTR_FLAGS, FLAG_INPUT | flag, mask);
                }
            }
            config.flags = FLAG_INPUT;
        }
        RequestKind::AsIs => {}
    }
    let mut raw = LineRequest {
        offsets: [0; LINES_MAX],
        consumer: [0; NAME_LEN],
        config,
        num_lines: request.offsets.len() as u32,
        event_buffer_size: 0,
        padding: [0; 5],
        fd: -1,
    };
    raw.offsets[..request.offsets.len()].copy_from_slice(&request.offsets);
    raw.consumer[..CONSUMER.len()].copy_from_slice(CONSUMER);
    raw
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::offset_of;

    /// The expected values are those that a C compiler computes from `linux/gpio.h`.
    #[test]
    fn numbers_and_layout_match_the_header() {
        assert_eq!(
            [GET_CHIPINFO, GET_LINEINFO, GET_LINE, GET_VALUES, SET_VALUES],
            [0x8044_B401, 0xC100_B405, 0xC250_B407, 0xC010_B40E, 0xC010_B40F]
        );
        assert_eq!((size_of::<LineConfig>(), size_of::<ConfigAttribute>()), (272, 24));
        assert_eq!([offset_of!(LineRequest, config), offset_of!(LineRequest, num_lines), offset_of!(LineRequest, fd)], [288, 560, 588]);
        assert_eq!([offset_of!(LineInfo, consumer), offset_of!(LineInfo, flags)], [32, 72]);
    }

    #[test]
    fn outputs_have_their_levels_from_the_request_on() {
        let raw = raw_request(&Request { offsets: vec![17, 5, 26], kind: RequestKind::Outputs(0b010) });
        assert_eq!((raw.num_lines, &raw.offsets[..3], raw.config.flags), (3, &[17, 5, 26][..], FLAG_OUTPUT));
        let a = &raw.config.attrs[0];
        assert_eq!((raw.config.num_attrs, a.id, a.value, a.mask), (1, ATTR_OUTPUT_VALUES, 0b010, 0b111));
        assert_eq!(&raw.consumer[..10], b"retroflex\0");
    }

    #[test]
    fn a_request_for_inputs_contains_their_pull_resistors() {
        let pulls = vec![Pull::Up, Pull::Off, Pull::Up, Pull::Down];
        let raw = raw_request(&Request { offsets: vec![1, 2, 3, 4], kind: RequestKind::Inputs(pulls) });
        let got: Vec<_> = raw.config.attrs[..3].iter().map(|a| (a.id, a.value, a.mask)).collect();
        assert_eq!(
            got,
            [
                (ATTR_FLAGS, FLAG_INPUT | FLAG_PULL_UP, 0b0101),
                (ATTR_FLAGS, FLAG_INPUT | FLAG_PULL_DOWN, 0b1000),
                (ATTR_FLAGS, FLAG_INPUT | FLAG_PULL_OFF, 0b0010)
            ]
        );
        assert_eq!((raw.config.num_attrs, raw.config.flags), (3, FLAG_INPUT));
    }
}
