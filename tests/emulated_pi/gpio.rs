//! A GPIO chip behind its character device, line interface version 2 (`linux/gpio.h`): it observes every
//! change of level and counts every step with the level that its DIR line has at that time.
//!
//! A line request must return a file descriptor to the caller, which a file server cannot do. The caller is therefore
//! started with some files of the server open at known numbers, and receives one of these.

use super::fuse::{Answer, Ioctl, long, word};
use retroflex::hardware::pins::PinsConfig;
use std::collections::BTreeMap;

/// Number of the first descriptor that a caller has open, one for each handle.
pub const HANDLE_FD: i32 = 200;
/// Handles a caller has.
pub const HANDLES: usize = 8;
/// Lines of the chip.
pub const LINES: u32 = 54;

const GET_CHIPINFO: u32 = 0x8044_B401;
const GET_LINEINFO: u32 = 0xC100_B405;
const GET_LINE: u32 = 0xC250_B407;
const GET_VALUES: u32 = 0xC010_B40E;
const SET_VALUES: u32 = 0xC010_B40F;

/// The chip and the three drivers wired to it.
pub struct Chip {
    wiring: PinsConfig,
    label: &'static str,
    levels: BTreeMap<u32, bool>,
    handles: Vec<Option<Vec<u32>>>,
    /// Lines that another program holds.
    pub held: BTreeMap<u32, &'static str>,
    /// Lines whose level does not follow.
    pub stuck: BTreeMap<u32, bool>,
    /// Levels of inputs.
    pub inputs: BTreeMap<u32, bool>,
    /// Steps of each channel, signed.
    pub counted: [i32; 3],
    /// Rising edges of all STEP lines.
    pub pulses: u64,
    /// Rising edges while the drivers were off, which turn no motor.
    pub lost: u64,
    /// Number of changes of a DIR line while its STEP line was high.
    pub torn: u64,
}

impl Chip {
    /// A chip with nothing requested.
    pub fn new(wiring: &PinsConfig, label: &'static str) -> Self {
        Self {
            wiring: wiring.clone(),
            label,
            levels: BTreeMap::new(),
            handles: vec![None; HANDLES],
            held: BTreeMap::new(),
            stuck: BTreeMap::new(),
            inputs: BTreeMap::new(),
            counted: [0; 3],
            pulses: 0,
            lost: 0,
            torn: 0,
        }
    }

    fn level(&self, line: u32) -> bool {
        self.levels.get(&line).copied().unwrap_or(false)
    }

    /// The drivers are energised: EN is low, to which the breakout pulls it.
    pub fn energised(&self) -> bool {
        self.wiring.channels.iter().all(|c| {
            c.enable
                .is_none_or(|line| self.level(line) != self.wiring.enable_active_low)
        })
    }

    /// A handle's file is closed: its lines are free, and keep their levels.
    pub fn release(&mut self, handle: usize) {
        self.handles[handle] = None;
    }

    fn set(&mut self, line: u32, high: bool) {
        if self.level(line) == high || self.stuck.contains_key(&line) {
            return;
        }
        self.levels.insert(line, high);
        for (i, c) in self.wiring.channels.iter().enumerate() {
            let rises = line == c.step && high != self.wiring.step_active_low;
            self.torn +=
                u64::from(line == c.dir && self.level(c.step) != self.wiring.step_active_low);
            if rises {
                self.pulses += 1;
                if self.energised() {
                    self.counted[i] += if self.level(c.dir) != c.dir_inverted {
                        1
                    } else {
                        -1
                    };
                } else {
                    self.lost += 1;
                }
            }
        }
    }

    /// An ioctl on the chip itself.
    pub fn on_chip(&mut self, call: &Ioctl<'_>) -> Answer {
        match call.number {
            GET_CHIPINFO => {
                let mut out = vec![0_u8; 68];
                out[..9].copy_from_slice(b"gpiochip0");
                out[32..32 + self.label.len()].copy_from_slice(self.label.as_bytes());
                out[64..68].copy_from_slice(&LINES.to_le_bytes());
                Answer::Done(0, out)
            }
            GET_LINEINFO => {
                let mut out = call.data.to_vec();
                let line = word(call.data, 64);
                if let Some(by) = self.held.get(&line) {
                    out[32..32 + by.len()].copy_from_slice(by.as_bytes());
                }
                // an output keeps its direction, as its level, when it is freed
                let flags = u64::from(self.levels.contains_key(&line)) << 3;
                out[72..80].copy_from_slice(&flags.to_le_bytes());
                Answer::Done(0, out)
            }
            GET_LINE => self.request(call.data),
            _ => Answer::Failed(libc::ENOTTY),
        }
    }

    /// A request of lines: 64 offsets, the consumer, flags and attributes, the number, the descriptor.
    fn request(&mut self, data: &[u8]) -> Answer {
        let n = word(data, 560) as usize;
        let lines: Vec<u32> = (0..n).map(|i| word(data, 4 * i)).collect();
        let taken = |line: &u32| {
            self.held.contains_key(line)
                || self.handles.iter().flatten().flatten().any(|l| l == line)
        };
        if lines.iter().any(|l| *l >= LINES) {
            return Answer::Failed(libc::EINVAL);
        }
        if lines.iter().any(taken) {
            return Answer::Failed(libc::EBUSY);
        }
        let Some(handle) = self.handles.iter().position(Option::is_none) else {
            return Answer::Failed(libc::EMFILE);
        };
        let (flags, attributes) = (long(data, 288), word(data, 296) as usize);
        if flags >> 3 & 1 == 1 {
            for a in 0..attributes {
                let at = 320 + 24 * a;
                let (id, value, mask) = (word(data, at), long(data, at + 8), long(data, at + 16));
                for (i, line) in lines
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| id == 2 && mask >> i & 1 == 1)
                {
                    self.set(*line, value >> i & 1 == 1);
                }
            }
        }
        self.handles[handle] = Some(lines);
        let mut out = data.to_vec();
        out[588..592].copy_from_slice(&(HANDLE_FD + handle as i32).to_le_bytes());
        Answer::Done(0, out)
    }

    /// An ioctl on a handle.
    pub fn on_handle(&mut self, handle: usize, call: &Ioctl<'_>) -> Answer {
        let Some(lines) = self.handles[handle].clone() else {
            return Answer::Failed(libc::EBADF);
        };
        let (bits, mask) = (long(call.data, 0), long(call.data, 8));
        let chosen = lines.iter().enumerate().filter(|(i, _)| mask >> i & 1 == 1);
        match call.number {
            SET_VALUES => {
                chosen.for_each(|(i, line)| self.set(*line, bits >> i & 1 == 1));
                Answer::Done(0, call.data.to_vec())
            }
            GET_VALUES => {
                let level = |line: &u32| {
                    let fixed = self
                        .stuck
                        .get(line)
                        .or_else(|| self.inputs.get(line))
                        .copied();
                    fixed.unwrap_or_else(|| self.level(*line))
                };
                let found = chosen.fold(0_u64, |b, (i, line)| b | u64::from(level(line)) << i);
                Answer::Done(0, [found.to_le_bytes(), mask.to_le_bytes()].concat())
            }
            _ => Answer::Failed(libc::ENOTTY),
        }
    }
}
