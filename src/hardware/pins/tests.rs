//! The requirements that the backends share. Every test runs on the GPIO character device, behind a kernel made of wires,
//! and on `embedded-hal` pins of the same wires, which is what the `rppal` backend consists of.

use crate::hardware::pins::config::{InputPin, PinsConfig, Pull};
use crate::hardware::pins::map::{LineMap, word};
use crate::hardware::pins::uapi::Kernel;
use crate::hardware::pins::{BoardPins, PinError, Pins, cdev, hal};
use crate::motion::{Inputs, Levels};
use embedded_hal::digital;
use gpiocdev_uapi::v2::ChipInfo;
use gpiocdev_uapi::v2::{LineAttributeValue, LineFlags, LineInfo, LineRequest};
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex};

/// EN and the emergency stop of the default wiring.
const EN: u32 = 5;
const STOP: u32 = 26;

/// Lines by offset.
#[derive(Debug, Default)]
struct Wires {
    /// Levels of outputs; a line that is absent was never driven.
    driven: BTreeMap<u32, bool>,
    /// Levels of inputs; high where absent.
    pulled: BTreeMap<u32, bool>,
    /// Changes of level.
    changes: u32,
    /// A line that stays at a level.
    stuck: Option<(u32, bool)>,
    /// Every access fails.
    broken: bool,
}

type Shared = Arc<Mutex<Wires>>;

impl Wires {
    fn set(&mut self, line: u32, high: bool) -> io::Result<()> {
        if self.broken {
            return Err(io::Error::from_raw_os_error(libc::EIO));
        }
        self.changes += u32::from(self.driven.insert(line, high) != Some(high));
        Ok(())
    }
    fn level(&self, line: u32) -> io::Result<bool> {
        if self.broken {
            return Err(io::Error::from_raw_os_error(libc::EIO));
        }
        let stuck = self.stuck.filter(|s| s.0 == line).map(|s| s.1);
        Ok(stuck
            .or(self.driven.get(&line).copied())
            .or(self.pulled.get(&line).copied())
            .unwrap_or(true))
    }
}

/// A kernel whose lines are wires.
struct WireKernel(Shared);

impl Kernel for WireKernel {
    type Chip = ();
    type Lines = Vec<u32>;
    fn open(&self, _: &str) -> io::Result<((), ChipInfo)> {
        let chip = ChipInfo {
            num_lines: 54,
            ..ChipInfo::default()
        };
        Ok(((), chip))
    }
    fn request(&self, (): &(), request: LineRequest) -> io::Result<Vec<u32>> {
        let offsets = request.offsets.0[..request.num_lines as usize].to_vec();
        let first = request.config.attr(0).attr.to_value();
        if let Some(LineAttributeValue::Values(bits)) = first {
            self.set(&offsets, u64::MAX, bits)?;
        }
        Ok(offsets)
    }
    fn state(&self, (): &(), offset: u32) -> io::Result<LineInfo> {
        let driven = self.0.lock().unwrap().driven.contains_key(&offset);
        Ok(LineInfo {
            flags: if driven {
                LineFlags::OUTPUT
            } else {
                LineFlags::INPUT
            },
            ..LineInfo::default()
        })
    }
    fn set(&self, lines: &Vec<u32>, mask: u64, bits: u64) -> io::Result<()> {
        let mut wires = self.0.lock().unwrap();
        lines
            .iter()
            .enumerate()
            .filter(|(i, _)| mask >> i & 1 == 1)
            .try_for_each(|(i, line)| wires.set(*line, bits >> i & 1 == 1))
    }
    fn get(&self, lines: &Vec<u32>, mask: u64) -> io::Result<u64> {
        let wires = self.0.lock().unwrap();
        lines
            .iter()
            .enumerate()
            .try_fold(0, |bits, (i, line)| {
                Ok(bits | u64::from(wires.level(*line)?) << i)
            })
            .map(|bits| bits & mask)
    }
}

/// An `embedded-hal` pin that is a wire.
struct WirePin(Shared, u32);

impl digital::ErrorType for WirePin {
    type Error = digital::ErrorKind;
}

impl digital::OutputPin for WirePin {
    fn set_low(&mut self) -> Result<(), digital::ErrorKind> {
        self.0
            .lock()
            .unwrap()
            .set(self.1, false)
            .map_err(|_| digital::ErrorKind::Other)
    }
    fn set_high(&mut self) -> Result<(), digital::ErrorKind> {
        self.0
            .lock()
            .unwrap()
            .set(self.1, true)
            .map_err(|_| digital::ErrorKind::Other)
    }
}

impl digital::InputPin for WirePin {
    fn is_high(&mut self) -> Result<bool, digital::ErrorKind> {
        self.0
            .lock()
            .unwrap()
            .level(self.1)
            .map_err(|_| digital::ErrorKind::Other)
    }
    fn is_low(&mut self) -> Result<bool, digital::ErrorKind> {
        self.is_high().map(|high| !high)
    }
}

/// Opens both backends, each on wires of its own that `prepare` has set up.
fn both(prepare: impl Fn(&mut Wires)) -> [(&'static str, BoardPins, Shared); 2] {
    let emergency_stop = Some(InputPin {
        pin: STOP,
        active_low: true,
        pull: Pull::Up,
    });
    let map = LineMap::new(
        &PinsConfig {
            emergency_stop,
            ..PinsConfig::default()
        },
        16,
    )
    .unwrap();
    let wires = || {
        let wires = Shared::default();
        prepare(&mut wires.lock().unwrap());
        wires
    };
    let kernel = wires();
    let cdev = cdev::open_with(WireKernel(kernel.clone()), "chip", "", map.clone()).unwrap();

    let pins = wires();
    let bits = |is: fn(&Wires, u32) -> bool| {
        let wires = pins.lock().unwrap();
        word(map.outputs.iter().map(|line| is(&wires, *line)))
    };
    let driven = bits(|wires, line| wires.driven.contains_key(&line));
    let energised = map.is_energised(driven, bits(|wires, line| wires.level(line).unwrap()));
    let wire = |line: &u32| WirePin(pins.clone(), *line);
    let (outputs, inputs) = (map.outputs.iter().map(wire).collect(), vec![wire(&STOP)]);
    let level = |pin: &WirePin| pin.0.lock().unwrap().level(pin.1).unwrap_or(false);
    let hal = hal::open(map, outputs, inputs, Some(level), energised).unwrap();
    [("cdev", cdev, kernel), ("rppal", hal, pins)]
}

#[test]
fn drivers_start_released_and_only_lines_that_differ_change() {
    for (name, mut pins, wires) in both(|_| ()) {
        assert!(
            !pins.found_energised() && wires.lock().unwrap().driven[&EN],
            "{name}: EN is high"
        );
        assert_eq!(
            wires.lock().unwrap().changes,
            7,
            "{name}: every output once"
        );
        let mut levels = Levels {
            enable: true,
            dir: [true, false, false],
            step: [false; 3],
        };
        for (step, changes) in [(false, 9), (true, 10), (true, 10), (false, 11)] {
            levels.step[0] = step;
            pins.write(&levels).unwrap();
            let wires = wires.lock().unwrap();
            assert_eq!(
                (wires.changes, wires.driven[&17]),
                (changes, step),
                "{name}"
            );
        }
        assert!(!wires.lock().unwrap().driven[&EN], "{name}");
    }
}

#[test]
fn drivers_that_an_earlier_program_left_energised_stay_so() {
    for (name, mut pins, wires) in both(|wires| _ = wires.driven.insert(EN, false)) {
        assert!(
            pins.found_energised() && !wires.lock().unwrap().driven[&EN],
            "{name}"
        );
        pins.check_enable().unwrap();
        pins.write(&Levels::default()).unwrap();
        assert!(
            wires.lock().unwrap().driven[&EN],
            "{name}: released on request"
        );
    }
    for (name, pins, _) in both(|wires| _ = wires.driven.insert(EN, true)) {
        assert!(!pins.found_energised(), "{name}");
    }
    // the breakout pulls a line low that nobody drives
    for (name, pins, wires) in both(|wires| _ = wires.pulled.insert(EN, false)) {
        assert!(
            !pins.found_energised() && wires.lock().unwrap().driven[&EN],
            "{name}"
        );
    }
}

#[test]
fn an_enable_line_that_does_not_follow_is_named() {
    for (name, mut pins, wires) in both(|_| ()) {
        pins.check_enable().unwrap();
        wires.lock().unwrap().stuck = Some((EN, false));
        let error = pins.check_enable().unwrap_err();
        assert!(
            matches!(
                error,
                PinError::EnableStuck {
                    pin: EN,
                    driven_high: true
                }
            ),
            "{name}: {error}"
        );
    }
}

#[test]
fn inputs_are_read_and_a_broken_line_is_an_error() {
    for (name, mut pins, wires) in both(|_| ()) {
        assert_eq!(pins.read().unwrap(), Inputs::default(), "{name}");
        wires.lock().unwrap().pulled.insert(STOP, false);
        assert!(pins.read().unwrap().emergency_stop, "{name}");
        wires.lock().unwrap().broken = true;
        assert!(
            pins.read().unwrap_err().to_string().contains("read"),
            "{name}"
        );
        let on = Levels::without_step(true);
        assert!(
            pins.write(&on).unwrap_err().to_string().contains("write"),
            "{name}"
        );
        wires.lock().unwrap().broken = false;
        pins.write(&on).unwrap();
        assert!(
            !wires.lock().unwrap().driven[&EN],
            "{name}: a write that failed is repeated"
        );
    }
}
