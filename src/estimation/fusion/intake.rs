//! Input checks of the filters: usable values and time steps.
//!
//! A sensor on a long cable loses samples, and a dead bus reads all zeros or all ones. The state of a filter is
//! recursive, so one such value would corrupt it for good. These checks remove values that no sensor can measure.
//! Readings that are merely inaccurate are weighted by the filters.

use crate::primitives::ImuSample;
use nalgebra::Vector3;
use std::ops::RangeInclusive;

/// Gravity, m/s², where nothing has measured it: an error of a percent is negligible, since the direction dominates.
pub const GRAVITY_M_S2: f64 = 9.81;
/// Longest step that is integrated, s. After a longer one a filter levels itself again.
pub const GAP_MAX_S: f64 = 1.0;
/// Plausible angular rates, rad/s: the largest is above the range of every MEMS gyroscope (4000 °/s), with margin.
const GYRO_RAD_S: RangeInclusive<f64> = 0.0..=100.0;
/// Plausible specific forces with a usable direction, m/s²: all zeros is a dead bus, less than the smallest is free fall; the largest,
/// 400 g, is above the range of every part.
const ACC_M_S2: RangeInclusive<f64> = 0.1..=4000.0;
/// Plausible fields with a usable direction, µT: the full range of the AK09916 is 4900.
const MAG_UT: RangeInclusive<f64> = 0.1..=50_000.0;

/// The parts of a sample that a filter may use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usable {
    /// Angular rate, rad/s, unless lost.
    pub gyro_rad_s: Option<Vector3<f64>>,
    /// Specific force, m/s², unless lost or without direction.
    pub acc_m_s2: Option<Vector3<f64>>,
    /// Magnetic field, µT, unless lost, without direction or not sampled.
    pub mag_ut: Option<Vector3<f64>>,
}

/// Removes from a sample what no sensor can measure.
pub fn usable(sample: &ImuSample) -> Usable {
    Usable {
        gyro_rad_s: Some(sample.gyro_rad_s).filter(|v| GYRO_RAD_S.contains(&v.norm())),
        acc_m_s2: Some(sample.acc_m_s2).filter(|v| ACC_M_S2.contains(&v.norm())),
        mag_ut: sample.mag_ut.filter(|v| MAG_UT.contains(&v.norm())),
    }
}

/// How a filter treats the time since the last sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Integrate over this many seconds.
    Go(f64),
    /// Too long to integrate: level again.
    Gap,
    /// No time has passed or the clock is invalid: ignore the sample.
    Ignore,
}

/// Classifies a time step in seconds.
pub fn step(dt_s: f64) -> Step {
    if !dt_s.is_finite() || dt_s <= 0.0 {
        Step::Ignore
    } else if dt_s > GAP_MAX_S {
        Step::Gap
    } else {
        Step::Go(dt_s)
    }
}

/// Fraction by which a first-order low-pass with time constant `tau_s` approaches its input in `dt_s`.
pub fn share(dt_s: f64, tau_s: f64) -> f64 {
    1.0 - (-dt_s / tau_s).exp()
}

/// Sum of readings of a vector.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mean {
    sum: Vector3<f64>,
    n: u32,
}

impl Mean {
    /// Adds a reading, if there is one.
    pub fn add(&mut self, reading: Option<Vector3<f64>>) {
        if let Some(reading) = reading {
            self.sum += reading;
            self.n += 1;
        }
    }
    /// Mean reading, if there was one.
    pub fn get(&self) -> Option<Vector3<f64>> {
        (self.n > 0).then(|| self.sum / f64::from(self.n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;

    #[test]
    fn implausible_values_are_removed() {
        let sample = |gyro: f64, acc: f64, mag: f64| ImuSample {
            t: Seconds(0.0),
            gyro_rad_s: Vector3::new(gyro, 0.0, 0.0),
            acc_m_s2: Vector3::new(0.0, acc, 0.0),
            mag_ut: Some(Vector3::new(0.0, 0.0, mag)),
        };
        let good = usable(&sample(0.0, 9.81, 40.0));
        assert!(good.gyro_rad_s.is_some() && good.acc_m_s2.is_some() && good.mag_ut.is_some());
        for bad in [f64::NAN, f64::INFINITY, -1e30] {
            let u = usable(&sample(bad, bad, bad));
            assert_eq!(
                (u.gyro_rad_s, u.acc_m_s2, u.mag_ut),
                (None, None, None),
                "{bad}"
            );
        }
        assert_eq!(usable(&sample(0.0, 0.0, 40.0)).acc_m_s2, None);
        assert_eq!(usable(&sample(0.0, 9.81, 0.0)).mag_ut, None);
    }

    #[test]
    fn invalid_and_long_steps_are_not_integrated() {
        for bad in [0.0, -0.01, f64::NAN, f64::INFINITY] {
            assert_eq!(step(bad), Step::Ignore, "{bad}");
        }
        assert_eq!(step(0.5), Step::Go(0.5));
        assert_eq!(step(1.5), Step::Gap);
    }
}
