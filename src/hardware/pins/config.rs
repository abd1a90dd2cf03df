//! The wiring: which line does what, and its polarity.

use crate::primitives::{Invalid, shown};
use crate::{choices, parameters};

choices! {
    /// How the lines are reached.
    pub enum Backend {
        /// GPIO character device: any Linux board.
        Cdev = "cdev",
        /// Mapped registers of a Raspberry Pi.
        Rppal = "rppal",
        /// No hardware.
        Mock = "mock",
    }
}

choices! {
    /// Resistor on an input.
    pub enum Pull {
        /// To the supply: a switch to ground reads low when closed.
        Up = "up",
        /// To ground.
        Down = "down",
        /// None: the board has its own.
        Off = "off",
    }
}

parameters! {
    /// An input line.
    pub struct InputPin: Copy, Eq {
        /// Line number (Broadcom number on a Raspberry Pi).
        pin: u32;
        /// Pressed is low: a normally open switch to ground. A normally closed switch, which also detects a broken wire, needs
        /// `false`.
        active_low: bool = true;
        /// Resistor of the line.
        pull: Pull = Pull::Up;
    }
}

parameters! {
    /// The lines of one driver.
    pub struct ChannelPins: Copy, Eq {
        /// STEP line, which pulses once a microstep.
        step: u32;
        /// DIR line, which sets the direction of a step.
        dir: u32;
        /// EN line, left out when it is hard-wired; channels may share one. GPIO 5 of a Raspberry Pi is pulled up at start,
        /// against the pull-down of the breakout.
        enable: Option<u32> = None;
        /// MS1, MS2 and MS3 lines, left out when they are strapped to `drive.microsteps`; channels may share them.
        ms: Option<[u32; 3]> = None;
        /// Reverses the motor. With `false`, DIR high elongates the bellow. `retroflex commission` measures it.
        dir_inverted: bool = false;
        /// Home switch.
        home: Option<InputPin> = None;
    }
}

parameters! {
    /// The wiring.
    pub struct PinsConfig: Eq {
        /// How the lines are reached: `rppal` (registers of a Raspberry Pi), `cdev` (GPIO character device of any Linux board,
        /// one call for all lines) or `mock` (no hardware, every edge is recorded).
        backend: Backend = Backend::Cdev;
        /// Device file of the chip, for `cdev`; `gpioinfo` lists the chips. On a Raspberry Pi 5 with an older kernel the header
        /// is on `/dev/gpiochip4`.
        chip: String = "/dev/gpiochip0".to_owned();
        /// Beginning of the label of that chip, for `cdev`, as `gpioinfo` prints it: `pinctrl-rp1` on a Raspberry Pi 5, `pinctrl-bcm` on
        /// the others. A chip with another label is refused, since the numbers of the device files depend on the kernel. Empty accepts
        /// any chip.
        chip_label: String = String::new();
        /// STEP rests high and pulses low. The A4988 steps on the rising edge and needs `false`.
        step_active_low: bool = false;
        /// EN is low when energised, as on the A4988.
        enable_active_low: bool = true;
        /// The drivers of channels 1 to 3, in the order of the bellows.
        channels: [ChannelPins; 3] = [channel(17, 23), channel(27, 24), channel(22, 25)];
        /// Emergency stop input.
        emergency_stop: Option<InputPin> = None;
    }
}

/// A driver whose EN line is shared, as in the reference wiring.
fn channel(step: u32, dir: u32) -> ChannelPins {
    ChannelPins {
        step,
        dir,
        enable: Some(5),
        ..ChannelPins::default()
    }
}

impl PinsConfig {
    /// Every line with its use, in the order of the file.
    pub fn uses(&self) -> Vec<Use> {
        let mut uses = Vec::new();
        let mut add = |key: String, name, pin, shared| {
            uses.push(Use {
                key,
                name,
                pin,
                shared,
            })
        };
        for (i, c) in self.channels.iter().enumerate() {
            let at = |key: &str| format!("channels.{i}.{key}");
            add(at("step"), "step", c.step, false);
            add(at("dir"), "dir", c.dir, false);
            if let Some(pin) = c.enable {
                add(at("enable"), "enable", pin, true);
            }
            for (n, (pin, name)) in c.ms.iter().flatten().zip(["ms1", "ms2", "ms3"]).enumerate() {
                add(at(&format!("ms.{n}")), name, *pin, true);
            }
            if let Some(home) = c.home {
                add(at("home.pin"), "home", home.pin, false);
            }
        }
        if let Some(stop) = self.emergency_stop {
            let key = "emergency_stop.pin".to_owned();
            add(key, "emergency_stop", stop.pin, false);
        }
        uses
    }

    /// Checks that every signal has a line of its own.
    ///
    /// # Errors
    /// The first line with two uses.
    pub fn validate(&self) -> Result<(), Invalid> {
        let uses = self.uses();
        for (n, u) in uses.iter().enumerate() {
            let may_share = |o: &Use| u.shared && o.shared && o.name == u.name;
            let clash = uses[..n].iter().find(|o| o.pin == u.pin && !may_share(o));
            if let Some(other) = clash {
                return Err(Invalid {
                    key: format!("pins.{}", u.key),
                    problem: format!("line {} is already {}", u.pin, shown(&format!("pins.{}", other.key))),
                    hint: "give every signal its own line; only `enable` and `ms` may be shared among channels".to_owned(),
                });
            }
        }
        Ok(())
    }
}

/// One use of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Use {
    /// The key below `pins`, as in the file.
    pub key: String,
    /// Signal.
    pub name: &'static str,
    /// Line number.
    pub pin: u32,
    /// May be shared with the same signal of another channel.
    pub shared: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wiring_reads_from_toml() {
        let c: PinsConfig = toml::from_str(
            "backend = \"rppal\"\nemergency_stop = { pin = 26, active_low = false }\n\
             [[channels]]\nstep = 2\ndir = 3\n[[channels]]\nstep = 4\ndir = 14\nenable = 15\n\
             [[channels]]\nstep = 18\ndir = 8\nms = [7, 1, 12]\nhome = { pin = 16 }\n",
        )
        .unwrap();
        assert_eq!(
            (c.backend, c.channels[1].enable),
            (Backend::Rppal, Some(15))
        );
        assert_eq!(
            c.channels[2].home,
            Some(InputPin {
                pin: 16,
                active_low: true,
                pull: Pull::Up
            })
        );
    }
}
