//! Converts logical levels to line voltages and back, for all backends.
//!
//! Line i of [`LineMap::outputs`] is bit i of a word of voltages (1 = high). The MS levels are those of
//! the A4988 (data sheet, Table 1): full 000, half 100, quarter 010, eighth 110, sixteenth 111 on MS1,
//! MS2, MS3.

use crate::hardware::pins::PinError;
use crate::hardware::pins::config::{InputPin, PinsConfig, Pull};
use crate::motion::{Inputs, Levels};
use crate::primitives::Invalid;

/// A word with bit i set where the i-th level is high.
pub fn word(levels: impl Iterator<Item = bool>) -> u64 {
    let bits = levels.enumerate().map(|(i, high)| u64::from(high) << i);
    bits.fold(0, |word, bit| word | bit)
}

/// The lines of a board and their functions.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LineMap {
    /// Line numbers of the outputs in the order of the bits.
    pub outputs: Vec<u32>,
    /// Line numbers and pull resistors of the inputs in the order of the bits.
    pub inputs: Vec<(u32, Pull)>,
    step: [u64; 3],
    dir: [u64; 3],
    /// Bits of the EN lines.
    pub enable: u64,
    inverted: u64,
    fixed: u64,
    home: [u64; 3],
    emergency_stop: u64,
    inputs_inverted: u64,
}

impl LineMap {
    /// Assigns bits to the lines of a valid configuration.
    ///
    /// # Errors
    /// [`Invalid`] when MS lines are wired and the chip does not support `microsteps`.
    pub fn new(config: &PinsConfig, microsteps: u32) -> Result<Self, Invalid> {
        let mut map = Self::default();
        for (i, c) in config.channels.iter().enumerate() {
            map.step[i] = map.output(c.step, config.step_active_low);
            map.dir[i] = map.output(c.dir, c.dir_inverted);
            if let Some(pin) = c.enable {
                map.enable |= map.output(pin, config.enable_active_low);
            }
            if let Some(pins) = c.ms {
                for (pin, high) in pins.into_iter().zip(ms_levels(microsteps)?) {
                    let bit = map.output(pin, false);
                    map.fixed |= if high { bit } else { 0 };
                }
            }
            map.home[i] = c.home.map_or(0, |input| map.input(input));
        }
        map.emergency_stop = config.emergency_stop.map_or(0, |input| map.input(input));
        Ok(map)
    }

    /// The bit of an output line, which several signals may share.
    fn output(&mut self, pin: u32, inverted: bool) -> u64 {
        let known = self.outputs.iter().position(|p| *p == pin);
        let bit = 1 << known.unwrap_or(self.outputs.len());
        if known.is_none() {
            self.outputs.push(pin);
        }
        self.inverted |= if inverted { bit } else { 0 };
        bit
    }

    fn input(&mut self, input: InputPin) -> u64 {
        self.inputs.push((input.pin, input.pull));
        let bit = 1 << (self.inputs.len() - 1);
        self.inputs_inverted |= if input.active_low { bit } else { 0 };
        bit
    }

    /// Voltages of all outputs for logical levels.
    pub fn output_bits(&self, levels: &Levels) -> u64 {
        let lines = |on: bool, bits: u64| if on { bits } else { 0 };
        let active = (0..3).fold(lines(levels.enable, self.enable), |active, i| {
            active | lines(levels.step[i], self.step[i]) | lines(levels.dir[i], self.dir[i])
        });
        (active ^ self.inverted) | self.fixed
    }

    /// Voltages of all outputs when the lines are taken: no step, with the drivers energised or not.
    pub fn first_bits(&self, energised: bool) -> u64 {
        self.output_bits(&Levels::without_step(energised))
    }

    /// Whether lines found in this state energise the drivers. Bit i of `driven` tells whether line i is an
    /// output, bit i of `high` whether it is high. Without an EN line the drivers count as released.
    pub fn is_energised(&self, driven: u64, high: u64) -> bool {
        let on = self.first_bits(true);
        self.enable != 0 && driven & self.enable == self.enable && (high ^ on) & self.enable == 0
    }

    /// Compares the EN lines with the voltages written.
    ///
    /// # Errors
    /// [`PinError::EnableStuck`] with the first line that differs.
    pub fn compare_enable(&self, written: u64, found: u64) -> Result<(), PinError> {
        let wrong = (written ^ found) & self.enable;
        if wrong == 0 {
            return Ok(());
        }
        let bit = wrong.trailing_zeros() as usize;
        Err(PinError::EnableStuck {
            pin: self.outputs[bit],
            driven_high: written >> bit & 1 == 1,
        })
    }

    /// Logical levels of all inputs for their voltages.
    pub fn inputs_from(&self, bits: u64) -> Inputs {
        let active = bits ^ self.inputs_inverted;
        Inputs {
            home: self.home.map(|bit| active & bit != 0),
            emergency_stop: active & self.emergency_stop != 0,
        }
    }
}

/// Levels of MS1 to MS3 of the A4988.
fn ms_levels(microsteps: u32) -> Result<[bool; 3], Invalid> {
    const TABLE: [(u32, [bool; 3]); 5] = [
        (1, [false, false, false]),
        (2, [true, false, false]),
        (4, [false, true, false]),
        (8, [true, true, false]),
        (16, [true, true, true]),
    ];
    let row = TABLE.into_iter().find(|row| row.0 == microsteps);
    row.map(|row| row.1).ok_or_else(|| Invalid {
        key: "drive.microsteps".to_owned(),
        problem: format!("{microsteps} must be 1, 2, 4, 8 or 16, since the MS lines are wired"),
        hint: "leave pins.channels[].ms out if they are hard-wired".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::pins::config::ChannelPins;

    fn config() -> PinsConfig {
        let home = Some(InputPin {
            pin: 16,
            active_low: true,
            pull: Pull::Up,
        });
        let mut c = PinsConfig {
            emergency_stop: Some(InputPin {
                pin: 26,
                active_low: false,
                pull: Pull::Down,
            }),
            ..PinsConfig::default()
        };
        c.channels[1] = ChannelPins {
            home,
            dir_inverted: true,
            ms: Some([6, 13, 19]),
            ..c.channels[1]
        };
        c
    }

    #[test]
    fn outputs_apply_polarity_and_share_lines() {
        let map = LineMap::new(&config(), 8).unwrap();
        assert_eq!(
            map.outputs,
            [17, 23, 5, 27, 24, 6, 13, 19, 22, 25],
            "the shared EN once"
        );
        let bit = |pin| 1_u64 << map.outputs.iter().position(|p| *p == pin).unwrap();
        let idle = map.output_bits(&Levels::default());
        assert_eq!(
            idle,
            bit(5) | bit(24) | bit(6) | bit(13),
            "EN high, inverted DIR high, MS 110"
        );
        let on = Levels {
            step: [true, false, false],
            dir: [true, true, false],
            enable: true,
        };
        assert_eq!(map.output_bits(&on), bit(17) | bit(23) | bit(6) | bit(13));
    }

    #[test]
    fn only_an_output_at_the_active_level_energises_the_drivers() {
        let map = LineMap::new(&config(), 8).unwrap();
        let en = 1 << map.outputs.iter().position(|p| *p == 5).unwrap();
        assert!(map.is_energised(u64::MAX, !en), "EN is active low");
        assert!(map.is_energised(en, 0));
        assert!(!map.is_energised(en, en), "high is released");
        assert!(!map.is_energised(!en, 0), "an input drives nothing");
        let high = LineMap::new(
            &PinsConfig {
                enable_active_low: false,
                ..config()
            },
            8,
        )
        .unwrap();
        assert!(high.is_energised(en, en) && !high.is_energised(en, 0));
        let mut bare = config();
        bare.channels.iter_mut().for_each(|c| c.enable = None);
        assert!(!LineMap::new(&bare, 8).unwrap().is_energised(u64::MAX, 0));
    }

    #[test]
    fn inputs_apply_polarity() {
        let map = LineMap::new(&config(), 16).unwrap();
        assert_eq!(map.inputs, [(16, Pull::Up), (26, Pull::Down)]);
        assert_eq!(map.inputs_from(0b01), Inputs::default());
        assert_eq!(
            map.inputs_from(0b10),
            Inputs {
                home: [false, true, false],
                emergency_stop: true
            }
        );
    }

    #[test]
    fn unsupported_microsteps_are_refused_only_if_the_ms_lines_are_wired() {
        assert_eq!(
            LineMap::new(&config(), 32).unwrap_err().key,
            "drive.microsteps"
        );
        LineMap::new(&PinsConfig::default(), 32).unwrap();
    }
}
