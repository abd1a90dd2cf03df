//! Finds still stretches ("rests") in a recording.
//!
//! A gyroscope alone cannot tell a slow steady rotation from a bias; the directions of gravity and of the field at
//! the two ends of the stretch can.

use super::refusal::Refusal;
use crate::estimation::fusion::intake::Mean;
use crate::primitives::ImuSample;
use nalgebra::Vector3;

crate::constants! {
    /// What a rest must fulfil.
    const REST: RestLimits;
    /// Largest standard deviation of the gyroscope, rad/s per axis: four times the noise of the supported parts.
    gyro_spread_max_rad_s = 0.02;
    /// Largest standard deviation of the accelerometer, m/s² per axis.
    acc_spread_max_m_s2 = 0.15;
    /// Largest tilt or heading change, degrees. A slow rotation of 0.5° in 2 s is a bias error of 0.25 °/s.
    turn_max_deg = 0.5;
    /// Shortest rest, s.
    duration_min_s = 1.0;
}

/// Fewest samples of a rest.
const SAMPLES_MIN: usize = 30;

/// Means over one rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// Position of its first sample.
    pub first: usize,
    /// Number of samples.
    pub samples: usize,
    /// First to last sample, s.
    pub duration_s: f64,
    /// Mean rate, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Standard deviation of the rate per axis, rad/s.
    pub gyro_std_rad_s: Vector3<f64>,
    /// Mean specific force, m/s².
    pub acc_m_s2: Vector3<f64>,
    /// Standard deviation of the specific force per axis, m/s².
    pub acc_std_m_s2: Vector3<f64>,
}

fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// Rotation between the first and the last third of the stretch, rad, by gravity and by the field.
fn turn(samples: &[ImuSample]) -> f64 {
    let third = samples.len() / 3;
    let (head, tail) = (&samples[..third], &samples[samples.len() - third..]);
    let turned = |of: fn(&ImuSample) -> Option<Vector3<f64>>| {
        let mean = |part: &[ImuSample]| {
            let mut mean = Mean::default();
            part.iter().for_each(|sample| mean.add(of(sample)));
            mean.get()
        };
        let between = mean(head).zip(mean(tail));
        between.map_or(0.0, |(a, b)| angle(&a, &b))
    };
    turned(|sample| Some(sample.acc_m_s2)).max(turned(|sample| sample.mag_ut))
}

/// Means of a stretch that should be one rest.
///
/// # Errors
/// [`Refusal`] if it is too short, not finite, or contains motion.
pub fn rest(samples: &[ImuSample]) -> Result<Rest, Refusal> {
    if let Some(index) = samples.iter().position(|s| !s.is_finite()) {
        return Err(Refusal::NotFinite { index });
    }
    Refusal::unless_enough(samples.len(), SAMPLES_MIN)?;
    let duration_s = samples[samples.len() - 1].t.0 - samples[0].t.0;
    if duration_s < REST.duration_min_s {
        let want =
            (samples.len() as f64 * REST.duration_min_s / duration_s.max(1e-9)).ceil() as usize;
        return Err(Refusal::TooFewSamples {
            have: samples.len(),
            want,
        });
    }
    let summary = |pick: fn(&ImuSample) -> Vector3<f64>| {
        let values = samples.iter().map(pick);
        let mean = values.clone().sum::<Vector3<f64>>() / samples.len() as f64;
        let squares: Vector3<f64> = values.map(|v| (v - mean).component_mul(&(v - mean))).sum();
        (mean, (squares / (samples.len() - 1) as f64).map(f64::sqrt))
    };
    let (gyro_rad_s, gyro_std_rad_s) = summary(|s| s.gyro_rad_s);
    let (acc_m_s2, acc_std_m_s2) = summary(|s| s.acc_m_s2);
    let checks = [
        (
            "the standard deviation of the gyroscope",
            gyro_std_rad_s.amax(),
            REST.gyro_spread_max_rad_s,
            "rad/s",
        ),
        (
            "the standard deviation of the accelerometer",
            acc_std_m_s2.amax(),
            REST.acc_spread_max_m_s2,
            "m/s²",
        ),
        (
            "the rotation from start to end",
            turn(samples).to_degrees(),
            REST.turn_max_deg,
            "deg",
        ),
    ];
    for (what, have, limit, unit) in checks {
        if have > limit {
            return Err(Refusal::Moving {
                what,
                have,
                limit,
                unit,
            });
        }
    }
    Ok(Rest {
        first: 0,
        samples: samples.len(),
        duration_s,
        gyro_rad_s,
        gyro_std_rad_s,
        acc_m_s2,
        acc_std_m_s2,
    })
}

/// All rests of a recording: adjacent windows of 1 s that pass [`rest`], joined where the attitude is
/// the same.
pub fn rests(samples: &[ImuSample]) -> Vec<Rest> {
    let mut found: Vec<Rest> = Vec::new();
    let mut from = 0;
    while from < samples.len() {
        let end_s = samples[from].t.0 + REST.duration_min_s;
        let Some(n) = samples[from..].iter().position(|s| s.t.0 >= end_s) else {
            break;
        };
        let Ok(window) = rest(&samples[from..=from + n]) else {
            from += (n / 4).max(1);
            continue;
        };
        let adjacent = found.last().filter(|r| r.first + r.samples >= from);
        let joined = adjacent.and_then(|Rest { first, .. }| {
            let longer = rest(&samples[*first..=from + n]).ok()?;
            Some(Rest {
                first: *first,
                ..longer
            })
        });
        if joined.is_some() {
            found.pop();
        }
        found.push(joined.unwrap_or(Rest {
            first: from,
            ..window
        }));
        from += n;
    }
    found
}
