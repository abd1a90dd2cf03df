//! Readings that repeat themselves: a sensor, or one axis of it, that is frozen.
//!
//! Noise changes every reading. A part may be quiet enough to repeat a value now and then, and a simulated axis may be free of noise
//! and change only while the tip moves, so an axis is only expected to change if it has never been seen to repeat itself.

use crate::primitives::ImuSample;

/// Readings of gyroscope and accelerometer.
const AXES: usize = 6;
/// Readings after which it is known whether an axis repeats itself, each time anew.
const KNOWN_AFTER: u32 = 500;
/// Times the repetitions of all axes together for one of them: an axis that changes every other time repeats itself 50 times in a row
/// once in 10¹⁵.
const ONE_AXIS: u32 = 2;

/// One axis.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Axis {
    last: f64,
    /// Repetitions since the last change.
    run: u32,
    /// Readings of the present count, and the repetitions among them.
    readings: u32,
    repetitions: u32,
    /// One count is complete.
    known: bool,
    /// Half of the readings of a count, or half as many in a row as of a frozen axis, were repetitions without a fault.
    repeats: bool,
}

impl Axis {
    fn add(&mut self, value: f64, most: u32) {
        if value == self.last {
            self.run = self.run.saturating_add(1);
            return;
        }
        // an axis that was frozen has not shown how it is, however often it is set up again
        if !self.is_stuck(most) {
            self.repeats |= self.run >= most;
            self.repetitions = self.repetitions.saturating_add(self.run);
            self.readings = self.readings.saturating_add(self.run).saturating_add(1);
        }
        (self.last, self.run) = (value, 0);
        if self.readings >= KNOWN_AFTER {
            self.known = true;
            self.repeats |= self.repetitions >= self.readings / 2;
            (self.readings, self.repetitions) = (0, 0);
        }
    }

    /// Whether an axis that is expected to change repeats itself; `most` is the number for all axes together.
    fn is_stuck(&self, most: u32) -> bool {
        self.run >= most.saturating_mul(ONE_AXIS) && self.known && !self.repeats
    }
}

/// Repetitions of all axes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Repetition([Axis; AXES]);

impl Repetition {
    /// Adds a reading. True if all axes have repeated themselves `most` times in a row, or twice as often one that is expected to change.
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

    /// False alarms of axes that are coarse or have no noise, in a tip that rests first, and then moves and rests by turns.
    #[test]
    fn an_axis_that_changes_only_in_motion_raises_no_alarm() {
        let (mut rng, mut alarms) = (StdRng::seed_from_u64(11), 0);
        for _ in 0..60 {
            let mut repetition = Repetition::default();
            let resolution: [f64; AXES] = std::array::from_fn(|_| {
                [f64::INFINITY, rng.random_range(0.01..4.0)][rng.random_range(0..2)]
            });
            let first = rng.random_range(100..2000);
            for (n, moves) in (0..40).map(|n| (n, n % 2 == 1)) {
                let readings = if n == 0 {
                    first
                } else {
                    rng.random_range(50..3000)
                };
                for k in 0..readings {
                    let motion = f64::from(k) * if moves { 3.7 } else { 0.0 };
                    let values: [f64; AXES] = std::array::from_fn(|i| {
                        let noise: f64 = StandardNormal.sample(&mut rng);
                        // the last axis keeps them from freezing all together
                        let resolution = if i == AXES - 1 { 0.1 } else { resolution[i] };
                        (noise / resolution).round() + motion
                    });
                    let sample = ImuSample {
                        t: Seconds(0.0),
                        gyro_rad_s: Vector3::from_column_slice(&values[..3]),
                        acc_m_s2: Vector3::from_column_slice(&values[3..]),
                        mag_ut: None,
                    };
                    alarms += u32::from(repetition.add(&sample, 25));
                }
            }
        }
        assert_eq!(alarms, 0);
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
