//! A backend of `embedded-hal` pins.

use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::{PinError, Pins};
use crate::motion::{Inputs, Levels};
use embedded_hal::digital::{InputPin, OutputPin, PinState};

/// One `embedded-hal` pin per line, in the order of the [`LineMap`].
#[derive(Debug)]
pub struct HalPins<O, I> {
    map: LineMap,
    outputs: Vec<O>,
    inputs: Vec<I>,
    bits: u64,
    level: Option<fn(&O) -> bool>,
    found_energised: bool,
}

impl<O: OutputPin, I: InputPin> HalPins<O, I> {
    /// Takes the pins, which must match the map in number and order, and writes all outputs once: STEP at
    /// its resting level, microstep levels set, and the drivers energised or released as given.
    ///
    /// # Errors
    /// [`PinError::Pin`] when that write fails.
    pub fn new(
        map: LineMap,
        outputs: Vec<O>,
        inputs: Vec<I>,
        energised: bool,
    ) -> Result<Self, PinError> {
        let bits = map.output_bits(&Levels::without_step(energised));
        let mut pins = Self {
            map,
            outputs,
            inputs,
            bits,
            level: None,
            found_energised: energised,
        };
        pins.apply(bits, u64::MAX)?;
        Ok(pins)
    }

    /// Reads EN back through `level`, which returns whether an output line is high.
    #[must_use]
    pub fn reading_back(mut self, level: fn(&O) -> bool) -> Self {
        self.level = Some(level);
        self
    }

    fn apply(&mut self, bits: u64, changed: u64) -> Result<(), PinError> {
        for (i, pin) in self
            .outputs
            .iter_mut()
            .enumerate()
            .filter(|(i, _)| changed >> i & 1 == 1)
        {
            let state = PinState::from(bits >> i & 1 == 1);
            pin.set_state(state)
                .map_err(|e| PinError::Pin("write", format!("{e:?}")))?;
        }
        self.bits = bits;
        Ok(())
    }
}

impl<O: OutputPin + Send, I: InputPin + Send> Pins for HalPins<O, I> {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        let bits = self.map.output_bits(levels);
        self.apply(bits, bits ^ self.bits)
    }

    fn found_energised(&self) -> bool {
        self.found_energised
    }

    fn check_enable(&mut self) -> Result<(), PinError> {
        let Some(level) = self.level else {
            return Ok(());
        };
        let found = self
            .outputs
            .iter()
            .enumerate()
            .fold(0, |bits, (i, pin)| bits | u64::from(level(pin)) << i);
        self.map.compare_enable(self.bits, found)
    }

    fn read(&mut self) -> Result<Inputs, PinError> {
        let mut bits = 0;
        for (i, pin) in self.inputs.iter_mut().enumerate() {
            let high = pin
                .is_high()
                .map_err(|e| PinError::Pin("read", format!("{e:?}")))?;
            bits |= u64::from(high) << i;
        }
        Ok(self.map.inputs_from(bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::config::{InputPin as Input, PinsConfig, Pull};
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};

    /// Output pins 17, 23, 5, 27, 24, 22 and 25 that expect exactly these levels.
    fn pins(expected: [&[State]; 7]) -> Vec<Mock> {
        expected
            .map(|states| {
                Mock::new(
                    &states
                        .iter()
                        .map(|s| Transaction::set(*s))
                        .collect::<Vec<_>>(),
                )
            })
            .into()
    }

    #[test]
    fn only_changed_lines_are_written() {
        use State::{High, Low};
        let map = LineMap::new(&PinsConfig::default(), 16).unwrap();
        let outputs = pins([
            &[Low, High, Low],
            &[Low, High],
            &[High, Low],
            &[Low],
            &[Low],
            &[Low],
            &[Low],
        ]);
        let mut checks = outputs.clone();
        let mut p = HalPins::<Mock, Mock>::new(map, outputs, vec![], false).unwrap();
        let mut l = Levels {
            enable: true,
            dir: [true, false, false],
            step: [false; 3],
        };
        p.write(&l).unwrap();
        l.step[0] = true;
        p.write(&l).unwrap();
        p.write(&l).unwrap();
        l.step[0] = false;
        p.write(&l).unwrap();
        checks.iter_mut().for_each(Mock::done);
    }

    #[test]
    fn inputs_are_read_and_a_failed_read_is_an_error() {
        let config = PinsConfig {
            emergency_stop: Some(Input {
                pin: 26,
                active_low: true,
                pull: Pull::Up,
            }),
            ..PinsConfig::default()
        };
        let map = LineMap::new(&config, 16).unwrap();
        let broken = Transaction::get(State::High)
            .with_error(MockError::Io(std::io::ErrorKind::NotConnected));
        let stop = Mock::new(&[
            Transaction::get(State::Low),
            Transaction::get(State::High),
            broken,
        ]);
        let mut check = stop.clone();
        let quiet = pins([
            &[State::Low],
            &[State::Low],
            &[State::High],
            &[State::Low],
            &[State::Low],
            &[State::Low],
            &[State::Low],
        ]);
        let mut checks = quiet.clone();
        let mut p = HalPins::new(map, quiet, vec![stop], false).unwrap();
        assert!(p.read().unwrap().emergency_stop);
        assert!(!p.read().unwrap().emergency_stop);
        assert!(
            p.read()
                .unwrap_err()
                .to_string()
                .contains("GPIO read failed")
        );
        check.done();
        checks.iter_mut().for_each(Mock::done);
    }
}
