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
    fn add(&mut self, value: f64, most: u32) {
        if value == self.last {
            self.run = self.run.saturating_add(1);
            return;
        }
        // an axis that was frozen has not shown how it usually is, however often it is set up again
        let run = if self.is_stuck(most) { 0 } else { self.run };
        self.last = value;
        self.repetitions = self.repetitions.saturating_add(run);
        self.readings = self.readings.saturating_add(run).saturating_add(1);
        self.run = 0;
        if self.readings > MEMORY {
            (self.readings, self.repetitions) = (self.readings / 2, self.repetitions / 2);
        }
    }

    /// Whether an axis that usually changes has repeated itself too often in a row; `most` is the number for all axes together.
    fn is_stuck(&self, most: u32) -> bool {
        let usually_changes = self.readings >= KNOWN_AFTER && self.repetitions < self.readings / 2;
        self.run >= most.saturating_mul(ONE_AXIS) && usually_changes
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
            axis.add(*value, most);
        }
        let all = self.0.iter().all(|axis| axis.run >= most);
        all || self.0.iter().any(|axis| axis.is_stuck(most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::Seconds;
    use nalgebra::Vector3;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    /// Any axis, after any time, set up again as often as the driver does, whereafter it shows another value: it stays frozen
    /// until it changes.
    #[test]
    fn an_axis_stays_frozen_until_it_changes() {
        let mut rng = StdRng::seed_from_u64(9);
        for _ in 0..40 {
            let (mut repetition, axis) = (Repetition::default(), rng.random_range(0..6_usize));
            let (from, every) = (rng.random_range(600..4000), rng.random_range(300..3000));
            let to = from + rng.random_range(10..30) * every;
            let (mut frozen, mut judged) = (0, 0);
            for n in 0..to + 200 {
                let mut values: [f64; AXES] = std::array::from_fn(|_| {
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    (4.0 * noise).round()
                });
                let stuck = (from..to).contains(&n);
                if stuck {
                    values[axis] = f64::from((n - from) / every);
                }
                let sample = ImuSample {
                    t: Seconds(0.0),
                    gyro_rad_s: Vector3::from_column_slice(&values[..3]),
                    acc_m_s2: Vector3::from_column_slice(&values[3..]),
                    mag_ut: None,
                };
                let found = repetition.add(&sample, 25);
                if stuck && (n - from) % every > 60 {
                    judged += 1;
                    frozen += u32::from(found);
                }
                assert!(stuck || !found || n < to + 60, "{n} of {from} to {to}");
            }
            assert_eq!(frozen, judged, "axis {axis}, {from} to {to}, every {every}");
        }
    }

    /// False alarms over the resolution of a part, in standard deviations of its noise: half an hour at 500 Hz each, at rest.
    #[test]
    fn a_part_of_any_resolution_raises_no_alarm() {
        for resolution in [0.01, 0.5, 1.0, 1.4, 1.6, 1.8, 2.0, 2.5, 3.0, 3.5] {
            let mut rng = StdRng::seed_from_u64(7);
            let mut repetition = Repetition::default();
            let mut alarms = 0;
            for _ in 0..900_000 {
                let mut value = || -> f64 {
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    (noise / resolution).round()
                };
                let sample = ImuSample {
                    t: Seconds(0.0),
                    gyro_rad_s: Vector3::from_fn(|_, _| value()),
                    acc_m_s2: Vector3::from_fn(|_, _| value()),
                    mag_ut: None,
                };
                alarms += u32::from(repetition.add(&sample, 25));
            }
            println!("{resolution} σ: {alarms} alarms");
            assert_eq!(alarms, 0, "{resolution} σ");
        }
    }
}
