//! Logs that cannot be diagnosed.

use crate::log::bend_log::BendLog;
use nalgebra::Vector3;
use thiserror::Error;

/// Shortest log that is diagnosed, s: less than one pair of long held-out blocks decides nothing.
const LENGTH_MIN_S: f64 = 20.0;
/// Piston path below which a log counts as motionless, mm.
const PATH_MIN_MM: f64 = 20.0;
/// Shortest rest at the start, s.
const REST_MIN_S: f64 = 1.0;
/// A channel counts as clipped if more than this share of at least [`CLIPPED_ROWS_MIN`] moving rows has one extreme value.
const CLIPPED_SHARE: f64 = 0.05;
/// Moving rows needed to judge clipping.
const CLIPPED_ROWS_MIN: usize = 200;

/// Why a log cannot be diagnosed.
#[derive(Debug, Error, PartialEq)]
pub enum ObserveError {
    /// The log is too short.
    #[error(
        "the log is {0:.1} s long; a diagnosis needs at least 20 s, and about 250 s with holds and several speeds: record the schedule of `retroflex gap excite`"
    )]
    Short(f64),
    /// The pistons do not move.
    #[error(
        "the pistons travel {0:.1} mm in the whole log; a tip that does not move shows no effect: record the schedule of `retroflex gap excite`"
    )]
    Motionless(f64),
    /// No sensor is logged.
    #[error(
        "the log has neither a tip IMU (acc_*, gyr_*) nor a reference (ref_q*) with values in it: record at least one of them"
    )]
    Blind,
    /// The log does not start at rest.
    #[error(
        "the pistons move within the first {0:.1} s; the rest at the start defines zero bend and the base frame: record at least 2 s of rest first"
    )]
    NoRest(f64),
    /// A sensor is saturated or frozen.
    #[error(
        "{0} has one value, {1}, for {2:.0} % of the moving time: it is clipped or frozen; choose a larger range, or check the sensor, and record again"
    )]
    Clipped(&'static str, f64, f64),
}

/// Refuses a log that cannot be diagnosed.
///
/// # Errors
/// [`ObserveError`].
pub fn refuse(log: &BendLog) -> Result<(), ObserveError> {
    let duration = log.t_s.last().copied().unwrap_or(0.0) - log.t_s.first().copied().unwrap_or(0.0);
    if duration < LENGTH_MIN_S {
        return Err(ObserveError::Short(duration));
    }
    let moved = log.piston_mm.windows(2).map(|w| (w[1] - w[0]).abs().sum());
    let path: f64 = moved.sum();
    if path < PATH_MIN_MM {
        return Err(ObserveError::Motionless(path));
    }
    let away = |p: &Vector3<f64>| (p - log.piston_mm[0]).amax() > 1e-9;
    let moves = log.piston_mm.iter().position(away).unwrap_or(0);
    let rest_s = log.t_s[moves] - log.t_s[0];
    if rest_s < REST_MIN_S {
        return Err(ObserveError::NoRest(rest_s));
    }
    if let Some(imu) = &log.imu {
        clipped("acc_*_m_s2", &imu.acc, log)?;
        clipped("gyr_*_rad_s", &imu.gyr, log)?;
    }
    Ok(())
}

/// Refuses a sensor that is saturated or frozen.
fn clipped(name: &'static str, values: &[Vector3<f64>], log: &BendLog) -> Result<(), ObserveError> {
    let moves = |k: &usize| log.piston_mm[*k] != log.piston_mm[k - 1];
    let moving: Vec<usize> = (1..log.piston_mm.len()).filter(moves).collect();
    for axis in 0..3 {
        let column = || {
            let values = moving.iter().filter_map(|&k| values.get(k));
            values.map(|v| v[axis]).filter(|v| !v.is_nan())
        };
        let (n, none) = (column().count(), f64::INFINITY);
        let highest = column().fold(-none, f64::max);
        for extreme in [highest, column().fold(none, f64::min)] {
            let share = column().filter(|&v| v == extreme).count() as f64 / n.max(1) as f64;
            if n > CLIPPED_ROWS_MIN && share > CLIPPED_SHARE {
                return Err(ObserveError::Clipped(name, extreme, share * 100.0));
            }
        }
    }
    Ok(())
}
