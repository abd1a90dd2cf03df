//! A backend of `embedded-hal` pins.

use crate::hardware::pins::PinError;
use crate::hardware::pins::interface::{BoardPins, Lines};
use crate::hardware::pins::map::{LineMap, word};
use embedded_hal::digital::{InputPin, OutputPin, PinState};

/// One `embedded-hal` pin per line, in the order of the [`LineMap`].
struct HalLines<O, I> {
    outputs: Vec<O>,
    inputs: Vec<I>,
    level: Option<fn(&O) -> bool>,
}

/// Takes the pins, which must match the map in number and order, and writes all outputs once: STEP at its resting level, microstep
/// levels set, and the drivers energised or released as given. EN is read back through `level`, which returns whether an output
/// line is high.
///
/// # Errors
/// [`PinError::Pin`] when that write fails.
pub fn open<O, I>(
    map: LineMap,
    outputs: Vec<O>,
    inputs: Vec<I>,
    level: Option<fn(&O) -> bool>,
    energised: bool,
) -> Result<BoardPins, PinError>
where
    O: OutputPin + Send + 'static,
    I: InputPin + Send + 'static,
{
    let mut lines = HalLines {
        outputs,
        inputs,
        level,
    };
    lines.set(u64::MAX, map.first_bits(energised))?;
    Ok(BoardPins::new(map, lines, energised))
}

impl<O: OutputPin + Send, I: InputPin + Send> Lines for HalLines<O, I> {
    fn set(&mut self, mask: u64, bits: u64) -> Result<(), PinError> {
        let mut pins = self.outputs.iter_mut().enumerate();
        pins.try_for_each(|(i, pin)| match mask >> i & 1 {
            0 => Ok(()),
            _ => pin.set_state(PinState::from(bits >> i & 1 == 1)),
        })
        .map_err(|e| PinError::Pin("write", format!("{e:?}")))
    }

    fn outputs(&mut self, mask: u64) -> Result<Option<u64>, PinError> {
        let levels = |level| word(self.outputs.iter().map(level));
        Ok(self.level.map(|level| mask & levels(level)))
    }

    fn inputs(&mut self) -> Result<u64, PinError> {
        let mut pins = self.inputs.iter_mut().enumerate();
        pins.try_fold(
            0,
            |bits, (i, pin)| Ok(bits | u64::from(pin.is_high()?) << i),
        )
        .map_err(|e: I::Error| PinError::Pin("read", format!("{e:?}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::Pins;
    use crate::hardware::pins::config::{InputPin as Input, PinsConfig, Pull};
    use crate::motion::Levels;
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
        let mut p = open::<Mock, Mock>(map, outputs, vec![], None, false).unwrap();
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
        let mut p = open(map, quiet, vec![stop], None, false).unwrap();
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
