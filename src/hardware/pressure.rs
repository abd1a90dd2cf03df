//! Pressure sensors on I²C, one for each line: Honeywell ABP2 and MPR.
//!
//! Sources: data sheets 32350268 (ABP2) and 32332628 (MPR). Both take the command 0xAA 0x00 0x00, convert within 5 ms, and
//! answer a read with a status byte and 24 bits of pressure, most significant byte first. With the transfer function A the
//! range of the part lies between 10 % and 90 % of 2²⁴ counts. Parts with eight addresses exist (the sixth digit group of
//! the part number), so three of them share a bus. A differential part with one port open measures either sign.

use crate::parameters;
use embedded_hal::i2c::I2c;

/// Time of a conversion with a margin, ms.
pub const CONVERSION_MS: u64 = 6;
/// Counts at the ends of the range.
const COUNTS: [f64; 2] = [1_677_722.0, 15_099_494.0];
const MEASURE: [u8; 3] = [0xAA, 0x00, 0x00];
/// Status bits: power, busy, memory error, saturation. A valid answer has power alone.
const STATUS: u8 = 0b0110_0101;
const POWERED: u8 = 0b0100_0000;

parameters! {
    /// Pressure sensors, one for each line: Honeywell ABP2 or MPR with I²C and the transfer function A (10 to 90 %). They limit
    /// the pressure independently of the counted position: above `safety.pressure_max_kpa`, or without an answer for 0.1 s, the
    /// gate trips.
    pub struct PressureSection {
        /// Device file of the bus.
        bus: String = "/dev/i2c-1".to_owned();
        /// 7-bit bus addresses of the sensors of channels 1 to 3.
        addresses: [u8; 3] = [0x18, 0x28, 0x38], "", 8..=119, "three of 8, 24, 40, 56, 72, 88, 104 and 120 that nothing else has";
        /// Pressure at the lower end of the part's range. A wrong value falsifies every reading.
        low_kpa: f64 = -100.0, "kPa", -1200.0..=0.0, "-100 for a differential part of ±1 bar";
        /// Pressure at the upper end of the part's range. A wrong value falsifies every reading.
        high_kpa: f64 = 100.0, "kPa", 1.0..=1200.0, "100 for a differential part of ±1 bar";
    }
}

/// Why a reading is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PressureError {
    /// The transfer failed.
    #[error(
        "the pressure sensor at {0:#04x} does not answer: check plug, supply and pressure.addresses"
    )]
    Bus(u8),
    /// The status byte reports a fault.
    #[error(
        "the pressure sensor at {0:#04x} has status {1:#04x} instead of 0x40: cycle its power, and replace it if this persists"
    )]
    Status(u8, u8),
}

/// One sensor.
#[derive(Debug)]
pub struct PressureSensor<I> {
    bus: I,
    address: u8,
    range_kpa: [f64; 2],
}

impl<I: I2c> PressureSensor<I> {
    /// The sensor of a channel from 0.
    pub fn new(bus: I, config: &PressureSection, channel: usize) -> Self {
        Self {
            bus,
            address: config.addresses[channel],
            range_kpa: [config.low_kpa, config.high_kpa],
        }
    }

    /// Starts a conversion.
    ///
    /// # Errors
    /// [`PressureError::Bus`].
    pub fn start(&mut self) -> Result<(), PressureError> {
        let sent = self.bus.write(self.address, &MEASURE);
        sent.map_err(|_| PressureError::Bus(self.address))
    }

    /// Reads the result of the conversion, kPa, [`CONVERSION_MS`] after its start.
    ///
    /// # Errors
    /// [`PressureError`]; a conversion that is not complete is an invalid status.
    pub fn fetch(&mut self) -> Result<f64, PressureError> {
        let mut answer = [0; 4];
        let read = self.bus.read(self.address, &mut answer);
        read.map_err(|_| PressureError::Bus(self.address))?;
        let [status, high, middle, low] = answer;
        if status & STATUS != POWERED {
            return Err(PressureError::Status(self.address, status));
        }
        let counts = f64::from(u32::from_be_bytes([0, high, middle, low]));
        let [low_kpa, high_kpa] = self.range_kpa;
        Ok(low_kpa + (counts - COUNTS[0]) / (COUNTS[1] - COUNTS[0]) * (high_kpa - low_kpa))
    }
}
