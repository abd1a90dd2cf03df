//! Readings that repeat themselves: a sensor, or one axis of it, that is frozen.
//!
//! Noise changes every reading. A part may be quiet enough to repeat a value now and then, and a simulated axis may be free of noise,
//! so an axis is only expected to change if it usually does.

use crate::primitives::ImuSample;

/// Readings of gyroscope and accelerometer.
const AXES: usize = 6;
/// Readings after which it is known whether an axis usually changes.
const KNOWN_AFTER: u32 = 500;
/// Readings after which older ones count half.
const MEMORY: u32 = 20_000;
/// Times the repetitions of all axes together for one of them: an axis that changes every other time repeats itself 50 times in a row
/// once in 10¹⁵.
const ONE_AXIS: u32 = 2;

/// One axis.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Axis {
    last: f64,
    /// Repetitions since the last change.
    run: u32,
    /// Readings before these, and the repetitions among them.
    readings: u32,
    repetitions: u32,
}

impl Axis {
    fn add(&mut self, value: f64) {
        if value == self.last {
            self.run = self.run.saturating_add(1);
            return;
        }
        self.last = value;
        self.repetitions = self.repetitions.saturating_add(self.run);
        self.readings = self.readings.saturating_add(self.run).saturating_add(1);
        self.run = 0;
        if self.readings > MEMORY {
            (self.readings, self.repetitions) = (self.readings / 2, self.repetitions / 2);
        }
    }

    fn usually_changes(&self) -> bool {
        self.readings >= KNOWN_AFTER && self.repetitions < self.readings / 2
    }
}

/// Repetitions of all axes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Repetition([Axis; AXES]);

impl Repetition {
    /// Adds a reading. True if all axes have repeated themselves `most` times in a row, or twice as often one that usually changes.
    pub fn add(&mut self, sample: &ImuSample, most: u32) -> bool {
        let values = sample.gyro_rad_s.iter().chain(&sample.acc_m_s2);
        for (axis, value) in self.0.iter_mut().zip(values) {
            axis.add(*value);
        }
        let stuck =
            |axis: &Axis| axis.run >= most.saturating_mul(ONE_AXIS) && axis.usually_changes();
        self.0.iter().all(|axis| axis.run >= most) || self.0.iter().any(stuck)
    }
}
