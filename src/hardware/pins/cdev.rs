//! Pins through the GPIO character device, line interface version 2 (Linux 5.10 and newer;
//! `Documentation/userspace-api/gpio/chardev.rst`).
//!
//! All outputs form one request and all inputs another. One change of levels is therefore one ioctl
//! that moves every line that differs, and nothing is allocated. The crate `gpio-cdev` does not serve
//! here: it uses version 1 of the interface, which sets only whole requests and cannot enable pull
//! resistors, and it allocates for every read. `super::uapi` makes the five calls directly.
//!
//! When a program ends, the kernel frees its lines. Whether they then keep their levels depends on the driver of the chip
//! (`persist_gpio_outputs` on a Raspberry Pi). EN lines that are still driven are taken over with the level that they have.

use crate::hardware::pins::PinError;
use crate::hardware::pins::interface::{BoardPins, Lines};
use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::uapi::{self, Kernel, Uapi};
use gpiocdev_uapi::NUM_LINES_MAX;
use gpiocdev_uapi::v2::{LineFlags, LineRequest};
use std::io;

/// Chips that a computer may have.
const CHIPS_MAX: u32 = 32;

/// The lines of one chip.
struct CdevLines<K: Kernel> {
    kernel: K,
    outputs: K::Lines,
    /// The request for inputs, if there are any, and the word of all of them.
    inputs: Option<(K::Lines, u64)>,
}

/// Requests the lines of a map from the chip at `path`, whose label begins with `label`.
///
/// # Errors
/// [`PinError`]: no chip, another chip, no permission, no such line, or a line in use.
pub fn open(path: &str, label: &str, map: LineMap) -> Result<BoardPins, PinError> {
    open_with(Uapi, path, label, map)
}

/// [`open`] through another implementation of the kernel interface.
pub(super) fn open_with<K: Kernel + 'static>(
    kernel: K,
    path: &str,
    label: &str,
    map: LineMap,
) -> Result<BoardPins, PinError> {
    let (chip, lines) = chip(&kernel, path, label)?;
    let inputs = map.inputs.iter().map(|(pin, _)| pin);
    let mut requested = map.outputs.iter().chain(inputs);
    if let Some(&pin) = requested.find(|pin| **pin >= lines) {
        return Err(PinError::NoLine {
            chip: path.into(),
            pin,
            lines,
        });
    }
    if map.outputs.len().max(map.inputs.len()) > NUM_LINES_MAX {
        let problem = format!("more than {NUM_LINES_MAX} lines");
        return Err(PinError::Pin("request", problem));
    }
    // a line that cannot be read is refused by the request for outputs, with a reason
    let energised = found_energised(&kernel, &chip, &map).unwrap_or(false);
    let outputs = uapi::outputs(&map.outputs, map.first_bits(energised));
    let outputs = request(&kernel, &chip, path, outputs)?;
    let inputs = if map.inputs.is_empty() {
        None
    } else {
        let lines = request(&kernel, &chip, path, uapi::inputs(&map.inputs))?;
        Some((lines, (1 << map.inputs.len()) - 1))
    };
    let lines = CdevLines {
        kernel,
        outputs,
        inputs,
    };
    Ok(BoardPins::new(map, lines, energised))
}

impl<K: Kernel> Lines for CdevLines<K> {
    fn set(&mut self, mask: u64, bits: u64) -> Result<(), PinError> {
        let done = self.kernel.set(&self.outputs, mask, bits);
        done.map_err(PinError::io("write"))
    }

    fn outputs(&mut self, mask: u64) -> Result<Option<u64>, PinError> {
        let found = self.kernel.get(&self.outputs, mask);
        found.map(Some).map_err(PinError::io("read"))
    }

    fn inputs(&mut self) -> Result<u64, PinError> {
        let Some((lines, mask)) = &self.inputs else {
            return Ok(0);
        };
        self.kernel.get(lines, *mask).map_err(PinError::io("read"))
    }
}

/// Opens the chip at `path`, whose label begins with `label`. Returns the number of its lines too.
fn chip<K: Kernel>(kernel: &K, path: &str, label: &str) -> Result<(K::Chip, u32), PinError> {
    let (chip, info) = kernel.open(path).map_err(|e| open_error(e, path))?;
    let have = uapi::text(&info.label);
    if have.starts_with(label) {
        return Ok((chip, info.num_lines));
    }
    let is_wanted = |path: &String| {
        let opened = kernel.open(path);
        opened.is_ok_and(|(_, info)| uapi::text(&info.label).starts_with(label))
    };
    let mut paths = (0..CHIPS_MAX).map(|n| format!("/dev/gpiochip{n}"));
    Err(PinError::OtherChip {
        path: path.into(),
        have,
        want: label.into(),
        at: paths.find(is_wanted),
    })
}

/// Opens the chip at `path` as [`open`] does, and requests no line.
///
/// # Errors
/// [`PinError`]: no chip, another chip, or no permission.
pub fn probe(path: &str, label: &str) -> Result<(), PinError> {
    chip(&Uapi, path, label).map(|_| ())
}

/// Whether an earlier program left the EN lines driven at the level that energises the drivers.
fn found_energised<K: Kernel>(kernel: &K, chip: &K::Chip, map: &LineMap) -> io::Result<bool> {
    let is_enable = |(i, _): &(usize, &u32)| map.enable >> i & 1 == 1;
    let (places, offsets): (Vec<usize>, Vec<u32>) =
        map.outputs.iter().enumerate().filter(is_enable).unzip();
    for &offset in &offsets {
        let flags = kernel.state(chip, offset)?.flags;
        if !flags.contains(LineFlags::OUTPUT) {
            return Ok(false);
        }
    }
    if offsets.is_empty() {
        return Ok(false);
    }
    let lines = kernel.request(chip, uapi::as_is(&offsets))?;
    let found = kernel.get(&lines, (1 << offsets.len()) - 1)?;
    let places = places.into_iter().enumerate();
    let high = places.fold(0, |bits, (k, i)| bits | (found >> k & 1) << i);
    Ok(map.is_energised(map.enable, high))
}

/// Converts the error of opening a chip.
fn open_error(error: io::Error, path: &str) -> PinError {
    match (error.kind(), error.raw_os_error()) {
        (io::ErrorKind::NotFound, _) => PinError::NoChip(path.into()),
        (io::ErrorKind::PermissionDenied, _) => PinError::PermissionDenied(path.into()),
        (_, Some(libc::ENOTTY | libc::EINVAL | libc::ENODEV)) => PinError::NotAChip(path.into()),
        _ => PinError::io("open")(error),
    }
}

/// Requests lines. The error for a line in use names the line and its consumer.
fn request<K: Kernel>(
    kernel: &K,
    chip: &K::Chip,
    path: &str,
    request: LineRequest,
) -> Result<K::Lines, PinError> {
    let all = request.offsets.0;
    let offsets = all.into_iter().take(request.num_lines as usize);
    let refused = |error: io::Error| match (error.kind(), error.raw_os_error()) {
        (_, Some(libc::EBUSY)) => {
            let holder = |pin: u32| {
                let state = kernel.state(chip, pin).ok()?;
                (!state.consumer.is_empty()).then(|| (pin, Some(uapi::text(&state.consumer))))
            };
            let (pin, by) = offsets.clone().find_map(holder).unwrap_or((all[0], None));
            PinError::Busy { pin, by }
        }
        (_, Some(libc::ENOTTY | libc::EINVAL)) => PinError::NotAChip(path.into()),
        (io::ErrorKind::PermissionDenied, _) => PinError::PermissionDenied(path.into()),
        _ => PinError::io("request")(error),
    };
    kernel.request(chip, request).map_err(refused)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::Pins;
    use crate::hardware::pins::config::{InputPin, PinsConfig, Pull};
    use crate::motion::Levels;
    use gpiocdev_uapi::v2::ChipInfo;
    use gpiocdev_uapi::v2::LineInfo;
    use std::sync::{Arc, Mutex};

    #[test]
    fn the_error_for_a_stuck_enable_line_names_the_line() {
        let mut pins = open_with(
            Fake {
                inputs: 0,
                ..Fake::default()
            },
            "chip",
            "",
            map(),
        )
        .unwrap();
        let message = pins.check_enable().err().unwrap().to_string();
        assert!(
            message.contains("EN on GPIO 5 stays low when driven high"),
            "{message}"
        );
        pins.write(&Levels::without_step(true)).unwrap();
        pins.check_enable().unwrap();
    }

    /// A kernel that records requests and returns preset answers.
    #[derive(Debug, Default, Clone)]
    struct Fake {
        log: Arc<Mutex<Vec<String>>>,
        refuse: Option<i32>,
        consumer: Option<(u32, &'static str)>,
        inputs: u64,
    }

    impl Kernel for Fake {
        type Chip = ();
        type Lines = ();
        fn open(&self, path: &str) -> io::Result<((), ChipInfo)> {
            // an older kernel of a Pi 5: the header is chip 4
            let label = if path == "/dev/gpiochip4" {
                "pinctrl-rp1"
            } else {
                "gpio-brcmstb@107d508500"
            };
            let (num_lines, label) = (54, label.into());
            let name = path.into();
            Ok((
                (),
                ChipInfo {
                    name,
                    label,
                    num_lines,
                },
            ))
        }
        fn request(&self, (): &(), request: LineRequest) -> io::Result<()> {
            let offsets = &request.offsets.0[..request.num_lines as usize];
            let attribute = request.config.attr(0).attr.to_value();
            let mut log = self.log.lock().unwrap();
            log.push(format!("{offsets:?} {attribute:?}"));
            self.refuse
                .map_or(Ok(()), |e| Err(io::Error::from_raw_os_error(e)))
        }
        fn state(&self, (): &(), offset: u32) -> io::Result<LineInfo> {
            let holder = self.consumer.filter(|h| h.0 == offset);
            Ok(LineInfo {
                consumer: holder.map_or("", |h| h.1).into(),
                ..LineInfo::default()
            })
        }
        fn set(&self, (): &(), mask: u64, bits: u64) -> io::Result<()> {
            self.log
                .lock()
                .unwrap()
                .push(format!("set {mask:07b} {bits:07b}"));
            Ok(())
        }
        fn get(&self, (): &(), mask: u64) -> io::Result<u64> {
            Ok(self.inputs & mask)
        }
    }

    fn map() -> LineMap {
        let emergency_stop = Some(InputPin {
            pin: 26,
            active_low: true,
            pull: Pull::Up,
        });
        LineMap::new(
            &PinsConfig {
                emergency_stop,
                ..PinsConfig::default()
            },
            16,
        )
        .unwrap()
    }

    #[test]
    fn one_ioctl_changes_all_lines_that_differ() {
        let kernel = Fake::default();
        let log = kernel.log.clone();
        let mut pins = open_with(kernel, "chip", "", map()).unwrap();
        let mut l = Levels {
            enable: true,
            dir: [true, false, true],
            step: [false; 3],
        };
        pins.write(&l).unwrap();
        pins.write(&l).unwrap();
        l.step = [true; 3];
        pins.write(&l).unwrap();
        let log = log.lock().unwrap();
        assert!(
            log[0].contains("[17, 23, 5, 27, 24, 22, 25]") && log[0].contains("Values(4)"),
            "{}",
            log[0]
        );
        assert!(
            log[1].contains("[26]") && log[1].contains("BIAS_PULL_UP"),
            "{}",
            log[1]
        );
        assert_eq!(log[2..], ["set 1000110 1000010", "set 0101001 1101011"]);
        assert!(pins.read().unwrap().emergency_stop, "low is pressed");
    }

    #[test]
    fn the_error_for_a_line_in_use_names_its_consumer() {
        let busy = Fake {
            refuse: Some(libc::EBUSY),
            consumer: Some((27, "spi0 CS1")),
            ..Fake::default()
        };
        let message = open_with(busy, "chip", "", map())
            .err()
            .unwrap()
            .to_string();
        assert!(
            message.contains("GPIO 27 is in use by \"spi0 CS1\""),
            "{message}"
        );
        let old = Fake {
            refuse: Some(libc::EINVAL),
            ..Fake::default()
        };
        assert!(matches!(
            open_with(old, "chip", "", map()),
            Err(PinError::NotAChip(..))
        ));
    }

    #[test]
    fn a_line_that_the_chip_does_not_have_is_refused() {
        let mut config = PinsConfig::default();
        config.channels[1].step = 54;
        let map = LineMap::new(&config, 16).unwrap();
        let message = open_with(Fake::default(), "/dev/gpiochip0", "", map)
            .err()
            .unwrap()
            .to_string();
        assert!(
            message.contains("has no line 54, only 0 to 53"),
            "{message}"
        );
    }

    #[test]
    fn a_chip_with_another_label_is_refused_before_a_line_is_requested() {
        let open = |path: &str, label: &str| {
            let kernel = Fake::default();
            let log = Arc::clone(&kernel.log);
            let opened = open_with(kernel, path, label, map());
            (opened.map_err(|e| e.to_string()), log)
        };
        for (path, label, mend) in [
            ("/dev/gpiochip0", "pinctrl-rp1", "\"/dev/gpiochip4\""),
            ("/dev/gpiochip7", "pinctrl-rp1", "\"/dev/gpiochip4\""),
            ("/dev/gpiochip4", "pinctrl-bcm", "no chip of this computer"),
        ] {
            let (opened, log) = open(path, label);
            let why = opened.err().unwrap();
            assert!(why.contains(label) && why.contains(mend), "{why}");
            assert!(log.lock().unwrap().is_empty());
        }
        for label in ["pinctrl-rp1", "pinctrl", ""] {
            open("/dev/gpiochip4", label).0.unwrap();
        }
    }

    /// Runs against the kernel of the machine that runs the tests.
    #[test]
    fn missing_files_and_files_that_are_not_chips_have_errors_of_their_own() {
        let none = super::open("/dev/gpiochip-none", "", map()).err().unwrap();
        assert!(matches!(none, PinError::NoChip(..)), "{none}");
        let null = super::open("/dev/null", "", map()).err().unwrap();
        assert!(matches!(null, PinError::NotAChip(..)), "{null}");
    }
}
