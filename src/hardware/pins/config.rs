//! `[pins]` of a board file: which line does what, and which way round.

use crate::motion::ConfigError;
use serde::{Deserialize, Serialize};

/// How the lines are reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// GPIO character device: any Linux board.
    #[default]
    Cdev,
    /// Mapped registers of a Raspberry Pi.
    Rppal,
    /// No hardware.
    Mock,
}

/// Resistor on an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pull {
    /// To the supply: a switch to ground reads low when closed.
    #[default]
    Up,
    /// To ground.
    Down,
    /// None: the board has its own.
    Off,
}

/// An input line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputPin {
    /// Line number (BCM number on a Raspberry Pi).
    pub pin: u32,
    /// Pressed is low. Default true: a normally open switch to ground. A normally closed switch, which
    /// also notices a broken wire, wants false.
    #[serde(default = "yes")]
    pub active_low: bool,
    /// Resistor: `up` (default), `down` or `off`.
    #[serde(default)]
    pub pull: Pull,
}

fn yes() -> bool {
    true
}

/// The lines of one driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelPins {
    /// STEP line.
    pub step: u32,
    /// DIR line.
    pub dir: u32,
    /// EN line; left out when it is hard-wired. Several channels may share one.
    #[serde(default)]
    pub enable: Option<u32>,
    /// MS1 to MS3 lines; left out when they are hard-wired. Channels may share them.
    #[serde(default)]
    pub ms: Option<[u32; 3]>,
    /// Turns the motor the other way. Default false: DIR high elongates the bellow.
    #[serde(default)]
    pub dir_inverted: bool,
    /// Home switch, if there is one.
    #[serde(default)]
    pub home: Option<InputPin>,
}

/// `[pins]`: the wiring.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PinsConfig {
    /// How the lines are reached: `cdev` (default), `rppal` or `mock`.
    pub backend: Backend,
    /// Device file of the chip, for `cdev`. Default `/dev/gpiochip0`; on a Raspberry Pi 5 with an
    /// older kernel the header is on `/dev/gpiochip4`.
    pub chip: String,
    /// STEP rests high and pulses low. Default false: the A4988 steps on the rising edge.
    pub step_active_low: bool,
    /// EN is low when energised. Default true, as on the A4988.
    pub enable_active_low: bool,
    /// The drivers of channels 1 to 3.
    pub channels: [ChannelPins; 3],
    /// Emergency stop input, if there is one.
    pub emergency_stop: Option<InputPin>,
}

impl Default for PinsConfig {
    fn default() -> Self {
        let channel = |step, dir| ChannelPins { step, dir, enable: Some(5), ms: None, dir_inverted: false, home: None };
        Self {
            backend: Backend::default(),
            chip: "/dev/gpiochip0".into(),
            step_active_low: false,
            enable_active_low: true,
            channels: [channel(17, 23), channel(27, 24), channel(22, 25)],
            emergency_stop: None,
        }
    }
}

impl PinsConfig {
    /// Every line with what it is for, in the order of the file.
    #[must_use]
    pub fn uses(&self) -> Vec<Use> {
        let mut uses = Vec::new();
        for (i, c) in self.channels.iter().enumerate() {
            let mut add = |key: &str, name, pin, shared| uses.push(Use { key: format!("channels.{i}.{key}"), name, pin, shared });
            add("step", "step", c.step, false);
            add("dir", "dir", c.dir, false);
            if let Some(pin) = c.enable {
                add("enable", "enable", pin, true);
            }
            for (n, (pin, name)) in c.ms.iter().flatten().zip(["ms1", "ms2", "ms3"]).enumerate() {
                add(&format!("ms.{n}"), name, *pin, true);
            }
            if let Some(home) = c.home {
                add("home.pin", "home", home.pin, false);
            }
        }
        if let Some(stop) = self.emergency_stop {
            uses.push(Use { key: "emergency_stop.pin".to_owned(), name: "emergency_stop", pin: stop.pin, shared: false });
        }
        uses
    }

    /// Accepts the section or names what is wrong.
    ///
    /// # Errors
    /// [`ConfigError`] for a line that two things want.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let uses = self.uses();
        for (i, u) in uses.iter().enumerate() {
            let clash = uses[..i].iter().find(|o| o.pin == u.pin && !(u.shared && o.shared && o.name == u.name));
            if let Some(other) = clash {
                return Err(ConfigError {
                    key: "pins.channels",
                    value: format!("{} on line {}", u.name, u.pin),
                    allowed: format!("a line of its own, and line {} is {} already", u.pin, other.name),
                    mend: "Give every signal its own line; only EN and MS may be shared among channels.",
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
    fn the_default_wiring_is_sound() {
        PinsConfig::default().validate().unwrap();
    }

    #[test]
    fn a_line_used_twice_is_named() {
        let mut c = PinsConfig::default();
        c.channels[2].dir = c.channels[0].step;
        let words = c.validate().unwrap_err().to_string();
        assert!(words.contains("dir on line 17") && words.contains("step already"), "{words}");
        let mut c = PinsConfig::default();
        c.channels[1].ms = Some([5, 6, 13]);
        assert!(c.validate().is_err(), "MS1 on the EN line");
    }

    #[test]
    fn wiring_reads_from_toml() {
        let c: PinsConfig = toml::from_str(
            "backend = \"rppal\"\nemergency_stop = { pin = 26, active_low = false }\n\
             [[channels]]\nstep = 2\ndir = 3\n[[channels]]\nstep = 4\ndir = 14\nenable = 15\n\
             [[channels]]\nstep = 18\ndir = 8\nms = [7, 1, 12]\nhome = { pin = 16 }\n",
        )
        .unwrap();
        c.validate().unwrap();
        assert_eq!((c.backend, c.channels[1].enable), (Backend::Rppal, Some(15)));
        assert_eq!(c.channels[2].home, Some(InputPin { pin: 16, active_low: true, pull: Pull::Up }));
    }
}
