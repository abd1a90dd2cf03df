//! Register machine of a Honeywell ABP2 or MPR pressure sensor: one command, a conversion of 5 ms, four bytes.

use super::{Device, Motion, Noise, Quirks};

const CONVERSION_S: f64 = 5e-3;

/// A sensor of ±1 bar with the transfer function A.
#[derive(Debug)]
pub struct FakePressure {
    address: u8,
    /// True pressure, kPa.
    pub kpa: f64,
    /// Status bits that are set besides power.
    pub fault: u8,
    busy_s: f64,
    counts: u32,
    quirks: Quirks,
}

impl FakePressure {
    /// A sensor at ambient pressure.
    #[must_use]
    pub fn new(address: u8) -> Self {
        Self {
            address,
            kpa: 0.0,
            fault: 0,
            busy_s: 0.0,
            counts: 0,
            quirks: Quirks::default(),
        }
    }

    /// The sensor at a true pressure.
    #[must_use]
    pub fn at(mut self, kpa: f64) -> Self {
        self.kpa = kpa;
        self
    }

    /// The sensor with status bits set.
    #[must_use]
    pub fn with_fault(mut self, fault: u8) -> Self {
        self.fault = fault;
        self
    }
}

impl Device for FakePressure {
    fn answers(&self, address: u8) -> bool {
        address == self.address
    }
    fn write(&mut self, _: u8, bytes: &[u8]) {
        if bytes == [0xAA, 0, 0] {
            self.busy_s = CONVERSION_S;
            let full = f64::from(1 << 24);
            self.counts = (full * (0.1 + 0.8 * (self.kpa + 100.0) / 200.0))
                .round()
                .clamp(0.0, full - 1.0) as u32;
        }
    }
    fn read(&mut self, _: u8, out: &mut [u8]) {
        let busy = if self.busy_s > 0.0 { 0x20 } else { 0 };
        let [_, high, middle, low] = self.counts.to_be_bytes();
        for (byte, value) in out
            .iter_mut()
            .zip([0x40 | busy | self.fault, high, middle, low])
        {
            *byte = value;
        }
    }
    fn advance(&mut self, dt_s: f64) {
        self.busy_s -= dt_s;
    }
    fn set_motion(&mut self, _: &Motion) {}
    fn set_noise(&mut self, _: Noise) {}
    fn brown_out(&mut self) {
        (self.busy_s, self.counts) = (0.0, 0);
    }
    fn quirks(&mut self) -> &mut Quirks {
        &mut self.quirks
    }
}
