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

use crate::hardware::pins::config::Pull;
use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::uapi::{
    ChipInfo, Kernel, LINES_MAX, LineState, Request, RequestKind, Uapi,
};
use crate::hardware::pins::{PinError, Pins};
use crate::motion::{Inputs, Levels};
use std::io;

/// Chips that a computer may have.
const CHIPS_MAX: u32 = 32;

/// The lines of one chip.
#[derive(Debug)]
pub struct CdevPins<K: Kernel = Uapi> {
    kernel: K,
    map: LineMap,
    outputs: K::Lines,
    inputs: Option<K::Lines>,
    bits: u64,
    found_energised: bool,
}

impl CdevPins<Uapi> {
    /// Requests the lines of a map from the chip at `path`, whose label begins with `label`.
    ///
    /// # Errors
    /// [`PinError`]: no chip, another chip, no permission, no such line, or a line in use.
    pub fn open(path: &str, label: &str, map: LineMap) -> Result<Self, PinError> {
        Self::open_with(Uapi, path, label, map)
    }
}

impl<K: Kernel> CdevPins<K> {
    /// The same through another implementation of the kernel interface.
    ///
    /// # Errors
    /// As [`CdevPins::open`].
    pub fn open_with(kernel: K, path: &str, label: &str, map: LineMap) -> Result<Self, PinError> {
        let (chip, lines) = chip(&kernel, path, label)?;
        let requested = map
            .outputs()
            .iter()
            .chain(map.inputs().iter().map(|(pin, _)| pin));
        if let Some(&pin) = requested.clone().find(|pin| **pin >= lines) {
            return Err(PinError::NoLine {
                chip: path.into(),
                pin,
                lines,
            });
        }
        if map.outputs().len().max(map.inputs().len()) > LINES_MAX {
            return Err(PinError::Pin(
                "request",
                format!("more than {LINES_MAX} lines"),
            ));
        }
        // a line that cannot be read is refused by the request for outputs, with a reason
        let found_energised = found_energised(&kernel, &chip, &map).unwrap_or(false);
        let bits = map.output_bits(&Levels::without_step(found_energised));
        let outputs = Request {
            offsets: map.outputs().to_vec(),
            kind: RequestKind::Outputs(bits),
        };
        let outputs = request(&kernel, &chip, path, &outputs)?;
        let (offsets, pulls): (Vec<u32>, Vec<Pull>) = map.inputs().iter().copied().unzip();
        let inputs = match offsets.len() {
            0 => None,
            _ => Some(request(
                &kernel,
                &chip,
                path,
                &Request {
                    offsets,
                    kind: RequestKind::Inputs(pulls),
                },
            )?),
        };
        Ok(Self {
            kernel,
            map,
            outputs,
            inputs,
            bits,
            found_energised,
        })
    }
}

impl<K: Kernel> Pins for CdevPins<K> {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        let bits = self.map.output_bits(levels);
        let mask = bits ^ self.bits;
        if mask != 0 {
            self.kernel
                .set(&self.outputs, mask, bits)
                .map_err(PinError::io("write"))?;
            self.bits = bits;
        }
        Ok(())
    }

    fn found_energised(&self) -> bool {
        self.found_energised
    }

    fn check_enable(&mut self) -> Result<(), PinError> {
        let mask = self.map.enable;
        if mask == 0 {
            return Ok(());
        }
        let found = self
            .kernel
            .get(&self.outputs, mask)
            .map_err(PinError::io("read"))?;
        self.map.compare_enable(self.bits, found)
    }

    fn read(&mut self) -> Result<Inputs, PinError> {
        let Some(lines) = &self.inputs else {
            return Ok(Inputs::default());
        };
        let mask = (1_u64 << self.map.inputs().len()) - 1;
        let bits = self.kernel.get(lines, mask).map_err(PinError::io("read"))?;
        Ok(self.map.inputs_from(bits))
    }
}

/// Opens the chip at `path`, whose label begins with `label`. Returns the number of its lines too.
fn chip<K: Kernel>(kernel: &K, path: &str, label: &str) -> Result<(K::Chip, u32), PinError> {
    let (chip, ChipInfo { lines, label: have }) =
        kernel.open(path).map_err(|e| open_error(e, path))?;
    if have.starts_with(label) {
        return Ok((chip, lines));
    }
    let is_wanted = |path: &String| {
        let opened = kernel.open(path);
        opened.is_ok_and(|(_, info)| info.label.starts_with(label))
    };
    Err(PinError::OtherChip {
        path: path.into(),
        have,
        want: label.into(),
        at: (0..CHIPS_MAX)
            .map(|n| format!("/dev/gpiochip{n}"))
            .find(is_wanted),
    })
}

/// Opens the chip at `path` as [`CdevPins::open`] does, and requests no line.
///
/// # Errors
/// [`PinError`]: no chip, another chip, or no permission.
pub fn probe(path: &str, label: &str) -> Result<(), PinError> {
    chip(&Uapi, path, label).map(|_| ())
}

/// Whether an earlier program left the EN lines driven at the level that energises the drivers.
fn found_energised<K: Kernel>(kernel: &K, chip: &K::Chip, map: &LineMap) -> io::Result<bool> {
    let lines: Vec<(usize, u32)> = map
        .outputs()
        .iter()
        .copied()
        .enumerate()
        .filter(|(i, _)| map.enable >> i & 1 == 1)
        .collect();
    for &(_, offset) in &lines {
        if !kernel.state(chip, offset)?.output {
            return Ok(false);
        }
    }
    if lines.is_empty() {
        return Ok(false);
    }
    let request = Request {
        offsets: lines.iter().map(|(_, offset)| *offset).collect(),
        kind: RequestKind::AsIs,
    };
    let found = kernel.get(&kernel.request(chip, &request)?, (1 << lines.len()) - 1)?;
    let high = lines
        .iter()
        .enumerate()
        .fold(0, |bits, (k, (i, _))| bits | (found >> k & 1) << i);
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
    request: &Request,
) -> Result<K::Lines, PinError> {
    kernel
        .request(chip, request)
        .map_err(|error| match (error.kind(), error.raw_os_error()) {
            (_, Some(libc::EBUSY)) => {
                let held = request
                    .offsets
                    .iter()
                    .find_map(|&pin| match kernel.state(chip, pin) {
                        Ok(LineState {
                            consumer: Some(by), ..
                        }) => Some((pin, Some(by))),
                        _ => None,
                    });
                let (pin, by) = held.unwrap_or((request.offsets[0], None));
                PinError::Busy { pin, by }
            }
            (_, Some(libc::ENOTTY | libc::EINVAL)) => PinError::NotAChip(path.into()),
            (io::ErrorKind::PermissionDenied, _) => PinError::PermissionDenied(path.into()),
            _ => PinError::io("request")(error),
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::config::{InputPin, PinsConfig};
    use std::sync::{Arc, Mutex};

    #[test]
    fn the_error_for_a_stuck_enable_line_names_the_line() {
        let mut pins = CdevPins::open_with(
            Fake {
                inputs: 0,
                ..Fake::default()
            },
            "chip",
            "",
            map(),
        )
        .unwrap();
        let message = pins.check_enable().unwrap_err().to_string();
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
            let (lines, label) = (54, label.to_owned());
            Ok(((), ChipInfo { lines, label }))
        }
        fn request(&self, (): &(), request: &Request) -> io::Result<()> {
            self.log.lock().unwrap().push(format!("{request:?}"));
            self.refuse
                .map_or(Ok(()), |e| Err(io::Error::from_raw_os_error(e)))
        }
        fn state(&self, (): &(), offset: u32) -> io::Result<LineState> {
            Ok(LineState {
                consumer: self
                    .consumer
                    .filter(|h| h.0 == offset)
                    .map(|h| h.1.to_string()),
                output: false,
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
        let mut pins = CdevPins::open_with(kernel, "chip", "", map()).unwrap();
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
            log[0].contains("[17, 23, 5, 27, 24, 22, 25]") && log[0].contains("Outputs(4)"),
            "{}",
            log[0]
        );
        assert!(
            log[1].contains("[26]") && log[1].contains("Inputs([Up])"),
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
        let message = CdevPins::open_with(busy, "chip", "", map())
            .unwrap_err()
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
            CdevPins::open_with(old, "chip", "", map()),
            Err(PinError::NotAChip(..))
        ));
    }

    #[test]
    fn a_line_that_the_chip_does_not_have_is_refused() {
        let mut config = PinsConfig::default();
        config.channels[1].step = 54;
        let map = LineMap::new(&config, 16).unwrap();
        let message = CdevPins::open_with(Fake::default(), "/dev/gpiochip0", "", map)
            .unwrap_err()
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
            let opened = CdevPins::open_with(kernel, path, label, map());
            (opened.map_err(|e| e.to_string()), log)
        };
        for (path, label, mend) in [
            ("/dev/gpiochip0", "pinctrl-rp1", "\"/dev/gpiochip4\""),
            ("/dev/gpiochip7", "pinctrl-rp1", "\"/dev/gpiochip4\""),
            ("/dev/gpiochip4", "pinctrl-bcm", "no chip of this computer"),
        ] {
            let (opened, log) = open(path, label);
            let why = opened.unwrap_err();
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
        let none = CdevPins::open("/dev/gpiochip-none", "", map()).unwrap_err();
        assert!(matches!(none, PinError::NoChip(..)), "{none}");
        let null = CdevPins::open("/dev/null", "", map()).unwrap_err();
        assert!(matches!(null, PinError::NotAChip(..)), "{null}");
    }
}
