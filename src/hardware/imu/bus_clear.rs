//! Frees a bus whose data line a chip holds low.
//!
//! A chip that was interrupted while it sent a zero waits for the rest of its clock pulses and holds SDA low until then.
//! No transfer can begin. At most nine pulses let it finish the byte, and a stop condition ends the transfer (UM10204,
//! 3.1.16). The pulses need the lines as GPIO, and the lines must return to the bus controller afterwards. Only the
//! registers of a Raspberry Pi allow both; the kernel's GPIO device would leave the lines as inputs.

use embedded_hal::delay::DelayNs;
use rppal::gpio::{Gpio, IoPin, Level, Mode, Pin};

/// Half a clock period, µs: 50 kHz.
const HALF_US: u32 = 10;
/// SDA that stays low for this long is stuck: the longest transfer, 24 bytes at 100 kHz, takes 2.2 ms, and it does not
/// hold SDA low throughout.
const STUCK_US: u32 = 2500;

/// A line with a pull-up that belongs to a bus controller.
pub trait OpenDrainLine {
    /// Reads the line without taking it from the controller.
    fn is_high(&self) -> bool;
    /// Takes the line from the controller, and pulls it low or lets it rise.
    fn pull(&mut self, low: bool);
}

/// The result of [`clear`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BusState {
    /// SDA was high: the lines were not touched.
    Idle,
    /// SDA rose after this number of clock pulses.
    Freed(u8),
    /// SDA stays low.
    Stuck,
}

/// Clocks SCL up to nine times if SDA is stuck low, then sends a stop condition.
pub fn clear<L: OpenDrainLine>(sda: &mut L, scl: &mut L, delay: &mut dyn DelayNs) -> BusState {
    for _ in 0..STUCK_US / HALF_US {
        if sda.is_high() {
            return BusState::Idle;
        }
        delay.delay_us(HALF_US);
    }
    let mut pull = |line: &mut L, low| {
        line.pull(low);
        delay.delay_us(HALF_US);
    };
    pull(sda, false);
    let mut pulses = 0;
    while !sda.is_high() && pulses < 9 {
        pull(scl, true);
        pull(scl, false);
        pulses += 1;
    }
    let freed = sda.is_high();
    // stop condition: SDA rises while SCL is high
    for (line, low) in [(true, true), (false, true), (true, false), (false, false)] {
        pull(if line { &mut *scl } else { &mut *sda }, low);
    }
    if freed {
        BusState::Freed(pulses)
    } else {
        BusState::Stuck
    }
}

/// A line on the header of a Raspberry Pi. It returns to the bus controller when it is dropped.
struct HeaderLine {
    watched: Option<Pin>,
    taken: Option<IoPin>,
}

impl OpenDrainLine for HeaderLine {
    fn is_high(&self) -> bool {
        match (&self.watched, &self.taken) {
            (Some(pin), _) => pin.read() == Level::High,
            (None, taken) => taken.as_ref().is_none_or(IoPin::is_high),
        }
    }

    fn pull(&mut self, low: bool) {
        if let Some(pin) = self.watched.take() {
            self.taken = Some(pin.into_io(Mode::Input));
        }
        if let Some(pin) = &mut self.taken {
            pin.set_low();
            pin.set_mode(if low { Mode::Output } else { Mode::Input });
        }
    }
}

/// [`clear`] for SDA and SCL on the header of a Raspberry Pi. Lines that cannot be opened count as idle.
pub fn clear_header(lines: [u32; 2], delay: &mut dyn DelayNs) -> BusState {
    let open = |line: u32| {
        let number = u8::try_from(line).ok()?;
        let watched = Some(Gpio::new().ok()?.get(number).ok()?);
        Some(HeaderLine {
            watched,
            taken: None,
        })
    };
    match lines.map(open) {
        [Some(mut sda), Some(mut scl)] => clear(&mut sda, &mut scl, delay),
        _ => BusState::Idle,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::delay::NoopDelay;
    use std::cell::RefCell;
    use std::rc::Rc;

    /// A bus on which a chip holds SDA low until it has seen some clock pulses.
    #[derive(Default)]
    struct Bus {
        pulled: [bool; 2],
        taken: bool,
        pulses: u8,
        needs: u8,
        stops: u32,
    }

    struct Line(Rc<RefCell<Bus>>, usize);

    impl OpenDrainLine for Line {
        fn is_high(&self) -> bool {
            let bus = self.0.borrow();
            !bus.pulled[self.1] && (self.1 == 1 || bus.pulses >= bus.needs)
        }
        fn pull(&mut self, low: bool) {
            let mut bus = self.0.borrow_mut();
            let rises = bus.pulled[self.1] && !low;
            bus.taken = true;
            bus.pulled[self.1] = low;
            bus.pulses += u8::from(self.1 == 1 && rises);
            bus.stops +=
                u32::from(self.1 == 0 && rises && !bus.pulled[1] && bus.pulses >= bus.needs);
        }
    }

    fn cleared(needs: u8) -> (BusState, Bus) {
        let bus = Rc::new(RefCell::new(Bus {
            needs,
            ..Bus::default()
        }));
        let state = clear(
            &mut Line(bus.clone(), 0),
            &mut Line(bus.clone(), 1),
            &mut NoopDelay::new(),
        );
        (state, bus.take())
    }

    #[test]
    fn nine_clocks_and_a_stop_free_a_bus_that_a_chip_holds() {
        for needs in 1..=9 {
            let (state, bus) = cleared(needs);
            assert_eq!(
                (state, bus.stops, bus.pulled),
                (BusState::Freed(needs), 1, [false; 2])
            );
        }
        assert_eq!(cleared(200).0, BusState::Stuck, "a short to ground");
    }

    #[test]
    fn a_bus_that_is_idle_is_left_to_its_controller() {
        let (state, bus) = cleared(0);
        assert_eq!((state, bus.taken), (BusState::Idle, false));
    }
}
