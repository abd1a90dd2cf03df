//! Pins through the mapped registers of a Raspberry Pi (crate `rppal`).
//!
//! The pins keep their last levels when the program ends. EN therefore stays as the shutdown left it
//! instead of floating to "energised" on boards that pull it down. After a program was killed, EN stays
//! as it was; drivers found energised stay so, because a bent tip would otherwise lose its pressure.

use crate::hardware::pins::PinError;
use crate::hardware::pins::config::Pull;
use crate::hardware::pins::hal::HalPins;
use crate::hardware::pins::map::LineMap;
use crate::motion::Levels;
use rppal::gpio::{Error, Gpio, InputPin, Level, Mode, OutputPin, Pin};

/// Device file through which `rppal` maps the registers.
const DEVICE: &str = "/dev/gpiomem";

/// Opens the lines of a map on the header of this Raspberry Pi.
///
/// # Errors
/// [`PinError`]: not a Raspberry Pi, no permission, no such line, or a line in use by this program.
pub fn open(map: LineMap) -> Result<HalPins<OutputPin, InputPin>, PinError> {
    let gpio = Gpio::new().map_err(|e| pin_error(e, 0))?;
    let lines = map
        .outputs()
        .iter()
        .map(|&pin| get(&gpio, pin))
        .collect::<Result<Vec<Pin>, PinError>>()?;
    let bits = |is: fn(&Pin) -> bool| {
        lines
            .iter()
            .enumerate()
            .fold(0, |bits, (i, line)| bits | u64::from(is(line)) << i)
    };
    let energised = map.is_energised(
        bits(|line| line.mode() == Mode::Output),
        bits(|line| line.read() == Level::High),
    );
    let idle = map.output_bits(&Levels::without_step(energised));
    let mut outputs = Vec::with_capacity(lines.len());
    for (i, line) in lines.into_iter().enumerate() {
        // The line becomes an output and receives its level in one step, without a wrong level between.
        let mut line = if idle >> i & 1 == 1 {
            line.into_output_high()
        } else {
            line.into_output_low()
        };
        line.set_reset_on_drop(false);
        outputs.push(line);
    }
    let mut inputs = Vec::with_capacity(map.inputs().len());
    for &(pin, pull) in map.inputs() {
        let line = get(&gpio, pin)?;
        inputs.push(match pull {
            Pull::Up => line.into_input_pullup(),
            Pull::Down => line.into_input_pulldown(),
            Pull::Off => line.into_input(),
        });
    }
    Ok(HalPins::new(map, outputs, inputs, energised)?.reading_back(OutputPin::is_set_high))
}

/// One line of the header.
fn get(gpio: &Gpio, pin: u32) -> Result<Pin, PinError> {
    let number = u8::try_from(pin).map_err(|_| PinError::NoLine {
        chip: "this board".into(),
        pin,
        lines: 54,
    })?;
    gpio.get(number).map_err(|e| pin_error(e, pin))
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
