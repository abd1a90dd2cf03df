//! The wiring against the header: no line twice, none that is not there, none that has another job.

use crate::config::board::Board;
use crate::config::hardware::Header;
use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::{Backend, PinsConfig};
use crate::motion::ConfigError;
use crate::primitives::check::Checker;

/// Reports the first line that cannot be what the file says.
pub(super) fn check_pins(board: &Board, pins: &PinsConfig, to: &mut Checker) {
    to.holds("pins.chip", pins.chip.starts_with('/'), &format!("`{}` is no device file", pins.chip), "`ls /dev/gpiochip*` lists the chips");
    let uses = pins.uses();
    for (n, u) in uses.iter().enumerate() {
        let key = format!("pins.{}", u.key);
        check_header(board, pins.backend, &key, u.pin, to);
        let clash = uses[..n].iter().find(|o| o.pin == u.pin && !(u.shared && o.shared && o.name == u.name));
        if let Some(other) = clash {
            let problem = format!("line {} is pins.{} already", u.pin, other.key);
            to.refuse(&key, problem, "give every signal its own line; only `enable` and `ms` may be shared among channels");
        }
    }
    if let Err(ConfigError { key, value, allowed, mend }) = LineMap::new(pins, board.drive.microsteps) {
        to.refuse(key, format!("{value} must be {allowed}"), mend);
    }
}

/// A line of the header, or why not.
fn check_header(board: &Board, backend: Backend, key: &str, pin: u32, to: &mut Checker) {
    if board.machine.header == Header::Any && backend != Backend::Rppal {
        to.range(key, f64::from(pin), 0.0..=511.0, "", "`gpioinfo` lists the lines of a chip");
        return;
    }
    let numbers = "the header has GPIO 2 to 27 (Broadcom numbers, not positions on the header)";
    match pin {
        0 | 1 => to.refuse(key, format!("GPIO {pin} reads the identification EEPROM of an add-on board"), numbers),
        2 | 3 if uses_bus(board, "/dev/i2c-1") => {
            to.refuse(key, format!("GPIO {pin} is SDA or SCL of /dev/i2c-1, where the IMU is"), "choose another line");
        }
        2..=27 => {}
        _ => to.refuse(key, format!("the header has no GPIO {pin}"), numbers),
    }
}

fn uses_bus(board: &Board, bus: &str) -> bool {
    [&board.imu, &board.base_imu].into_iter().flatten().any(|imu| imu.bus == bus)
}
