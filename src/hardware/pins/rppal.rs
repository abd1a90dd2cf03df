//! Pins through the mapped registers of a Raspberry Pi (crate `rppal`).
//!
//! The pins keep their last levels when the program ends. EN therefore stays as the shutdown left it
//! instead of floating to "energised" on boards that pull it down. After a program was killed, EN stays
//! as it was; drivers found energised stay so, because a bent tip would otherwise lose its pressure.

use crate::hardware::pins::config::Pull;
use crate::hardware::pins::map::{LineMap, word};
use crate::hardware::pins::{BoardPins, PinError, hal};
use rppal::gpio::{Error, Gpio, InputPin, Level, Mode, OutputPin, Pin};

/// Device file through which `rppal` maps the registers.
const DEVICE: &str = "/dev/gpiomem";

/// Opens the lines of a map on the header of this Raspberry Pi.
///
/// # Errors
/// [`PinError`]: not a Raspberry Pi, no permission, no such line, or a line in use by this program.
pub fn open(map: LineMap) -> Result<BoardPins, PinError> {
    let gpio = Gpio::new().map_err(|e| pin_error(e, 0))?;
    let lines = map.outputs.iter().map(|&pin| get(&gpio, pin));
    let lines: Vec<Pin> = lines.collect::<Result<_, _>>()?;
    let driven = word(lines.iter().map(|line| line.mode() == Mode::Output));
    let high = word(lines.iter().map(|line| line.read() == Level::High));
    let energised = map.is_energised(driven, high);
    let first = map.first_bits(energised);
    // a line becomes an output and receives its level in one step, without a wrong level between
    let output = |(i, line): (usize, Pin)| {
        let mut line = match first >> i & 1 {
            0 => line.into_output_low(),
            _ => line.into_output_high(),
        };
        line.set_reset_on_drop(false);
        line
    };
    let outputs = lines.into_iter().enumerate().map(output).collect();
    let input = |&(pin, pull): &(u32, Pull)| -> Result<InputPin, PinError> {
        let line = get(&gpio, pin)?;
        Ok(match pull {
            Pull::Up => line.into_input_pullup(),
            Pull::Down => line.into_input_pulldown(),
            Pull::Off => line.into_input(),
        })
    };
    let inputs: Vec<InputPin> = map.inputs.iter().map(input).collect::<Result<_, _>>()?;
    let level: fn(&OutputPin) -> bool = OutputPin::is_set_high;
    hal::open(map, outputs, inputs, Some(level), energised)
}

/// One line of the header.
fn get(gpio: &Gpio, pin: u32) -> Result<Pin, PinError> {
    let number = u8::try_from(pin).map_err(|_| Error::PinNotAvailable(u8::MAX));
    let line = number.and_then(|number| gpio.get(number));
    line.map_err(|e| pin_error(e, pin))
}

/// Converts an error of the crate.
fn pin_error(error: Error, pin: u32) -> PinError {
    match error {
        Error::UnknownModel => PinError::UnknownModel,
        Error::PinUsed(_) => PinError::Busy {
            pin,
            by: Some("this program".into()),
        },
        Error::PinNotAvailable(_) => PinError::NoLine {
            chip: "this board".into(),
            pin,
            lines: 54,
        },
        Error::PermissionDenied(path) => PinError::PermissionDenied(path),
        Error::Io(source) if source.kind() == std::io::ErrorKind::PermissionDenied => {
            PinError::PermissionDenied(DEVICE.into())
        }
        Error::Io(source) => PinError::io("open")(source),
        Error::ThreadPanic => {
            PinError::Pin("open", "a thread of the GPIO library has panicked".into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_has_a_remedy() {
        let denied = std::io::Error::from(std::io::ErrorKind::PermissionDenied);
        for (error, words) in [
            (Error::UnknownModel, "pins.backend = \"cdev\""),
            (Error::PinUsed(17), "GPIO 17 is in use by \"this program\""),
            (Error::PinNotAvailable(99), "has no line 17"),
            (
                Error::PermissionDenied("/dev/gpiomem0".into()),
                "no permission for /dev/gpiomem0",
            ),
            (Error::Io(denied), "group gpio"),
        ] {
            let message = pin_error(error, 17).to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
