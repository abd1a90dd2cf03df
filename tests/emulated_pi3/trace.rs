//! Pulses as the emulated chip saw them: every store to GPSET0 and GPCLR0 (BCM2835 ARM Peripherals, p. 90),
//! from the trace of QEMU's memory-mapped writes.
//!
//! A line of the trace is `memory_region_ops_write cpu 1 mr 0x… addr 0x3f20001c value 0x20000 size 4 name …`.
//! Levels follow the stores; a rising STEP counts by the level that DIR has at that moment.

use retroflex::hardware::pins::PinsConfig;

/// Where the registers of the pins are on a BCM2837.
const GPIO: u64 = 0x3F20_0000;
const GPSET0: u64 = GPIO + 0x1C;
const GPCLR0: u64 = GPIO + 0x28;

/// The lines as stored to, and what three drivers on them would have counted.
#[derive(Debug, Clone)]
pub struct Lines {
    wiring: PinsConfig,
    level: u32,
    /// GPFSEL0 to GPFSEL2: what the lines are used for.
    pub select: [u32; 3],
    /// Steps of each channel, signed, made with current.
    pub counted: [i32; 3],
    /// Rising edges of each STEP line.
    pub pulses: [u64; 3],
    /// Those while the drivers had no current.
    pub lost: u64,
    /// Times a DIR line moved while its STEP line was high.
    pub torn: u64,
}

impl Lines {
    /// Lines that nobody has touched.
    pub fn new(wiring: &PinsConfig) -> Self {
        Self {
            wiring: wiring.clone(),
            level: 0,
            select: [0; 3],
            counted: [0; 3],
            pulses: [0; 3],
            lost: 0,
            torn: 0,
        }
    }

    fn is_high(&self, line: u32) -> bool {
        self.level >> line & 1 == 1
    }

    /// The drivers have current: EN is low.
    pub fn energised(&self) -> bool {
        self.wiring.channels.iter().all(|c| {
            c.enable
                .is_none_or(|line| self.is_high(line) != self.wiring.enable_active_low)
        })
    }

    /// A line is an output: 001 in its three bits.
    pub fn is_output(&self, line: u32) -> bool {
        self.select[(line / 10) as usize] >> (line % 10 * 3) & 7 == 1
    }

    /// Every line that the board names.
    pub fn named(&self) -> Vec<u32> {
        self.wiring
            .channels
            .iter()
            .flat_map(|c| [Some(c.step), Some(c.dir), c.enable])
            .flatten()
            .collect()
    }

    /// One line of the trace.
    pub fn take(&mut self, line: &str) {
        let field = |name: &str| {
            let mut words = line.split_whitespace();
            words.find(|w| *w == name)?;
            u64::from_str_radix(words.next()?.strip_prefix("0x")?, 16).ok()
        };
        let (Some(address), Some(value)) = (field("addr"), field("value")) else {
            return;
        };
        let value = value as u32;
        match address {
            GPSET0 => self.store(value, true),
            GPCLR0 => self.store(value, false),
            GPIO..GPSET0 if (address - GPIO) / 4 < 3 => {
                self.select[((address - GPIO) / 4) as usize] = value
            }
            _ => {}
        }
    }

    fn store(&mut self, value: u32, high: bool) {
        let before = self.level;
        self.level = if high {
            before | value
        } else {
            before & !value
        };
        let moved = before ^ self.level;
        for (i, c) in self.wiring.channels.iter().enumerate() {
            self.torn += u64::from(moved >> c.dir & 1 == 1 && before >> c.step & 1 == 1);
            if moved >> c.step & 1 == 1 && high {
                self.pulses[i] += 1;
                if self.energised() {
                    self.counted[i] += if self.is_high(c.dir) != c.dir_inverted {
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
}

#[test]
fn stores_become_steps() {
    let mut lines = Lines::new(super::board().pins.as_ref().unwrap());
    let mut store = |register: u64, value: u32| {
        lines.take(&format!(
            "memory_region_ops_write cpu 3 mr 0x7f0a addr {:#x} value {value:#x} size 4 name 'bcm2835_gpio'",
            GPIO + register
        ));
        lines.clone()
    };
    // GPIO 17 an output, EN (5) low as from reset; DIR (23) high, two pulses, DIR low, one pulse, EN off, one pulse
    assert!(store(0x04, 1 << 21).is_output(17));
    store(0x1C, 1 << 23);
    for _ in 0..2 {
        store(0x1C, 1 << 17);
        store(0x1C, 1 << 17); // a line that is high already does not rise
        store(0x28, 1 << 17);
    }
    assert_eq!(store(0x28, 1 << 23).counted, [2, 0, 0]);
    store(0x1C, 1 << 17);
    assert_eq!(store(0x28, 1 << 17).counted, [1, 0, 0]);
    assert!(!store(0x1C, 1 << 5).energised());
    store(0x1C, 1 << 17);
    let after = store(0x1C, 1 << 23);
    assert_eq!(
        (after.counted, after.pulses, after.lost, after.torn),
        ([1, 0, 0], [4, 0, 0], 1, 1)
    );
    // other registers and other words are nothing
    lines.take(
        "memory_region_ops_write cpu 3 mr 0x1 addr 0x3f201000 value 0x41 size 4 name 'pl011'",
    );
    lines.take("qemu-system-aarch64: warning");
    assert_eq!(lines.pulses, [4, 0, 0]);
}
