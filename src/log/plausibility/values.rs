//! Units of the clock and of the sensors, and single values beyond what the machine can do.

use crate::log::bend_log::{BendLog, ImuColumns};
use nalgebra::Vector3;

/// Place, finding, mend.
pub(super) type Finding = (String, String, String);

pub(super) fn finding(place: &str, finding: String, mend: &str) -> Option<Finding> {
    Some((place.to_owned(), finding, mend.to_owned()))
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut all: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let middle = all.len() / 2;
    (!all.is_empty()).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
}

fn periods(log: &BendLog) -> impl Iterator<Item = f64> {
    log.t_s.windows(2).map(|w| w[1] - w[0])
}

/// A clock in milliseconds or microseconds: rows far apart, and pistons that creep where they should run.
pub(super) fn clock_unit(log: &BendLog) -> Option<Finding> {
    let period_s = median(periods(log))?;
    let speed_mm_s = log.piston_mm.windows(2).zip(periods(log)).map(|(p, dt)| (p[1] - p[0]).amax() / dt).fold(0.0, f64::max);
    // at 2 kHz and 1 mm/s a clock in milliseconds gives 0.5 and 0.001
    if period_s < 0.4 || speed_mm_s == 0.0 || speed_mm_s > 0.3 {
        return None;
    }
    let unit = if speed_mm_s > 3e-4 { "milliseconds" } else { "microseconds" };
    finding(
        "column time_s",
        format!("looks like {unit}: rows are {period_s} apart and no piston moves faster than {speed_mm_s:.2e} mm per unit"),
        "write seconds",
    )
}

/// Accelerometer and magnetometer by the magnitude that they have most of the time.
pub(super) fn sensor_units(imu: &ImuColumns, prefix: &str) -> Option<Finding> {
    if let Some(a) = median(imu.acc.iter().map(|v| v.norm())) {
        let unit = match a {
            // a clipped or very noisy sensor has another magnitude, but the right unit
            2.0..=100.0 => None,
            0.5..2.0 => Some("g"),
            500.0..=2000.0 => Some("milli-g or cm/s²"),
            _ => Some("neither m/s² nor g"),
        };
        if let Some(unit) = unit {
            let place = format!("columns {prefix}acc_*");
            return finding(&place, format!("{prefix}acc_* looks like {unit}: at rest |a| = {a:.3}"), "write m/s²: 9.81 at rest");
        }
    }
    let m = median(imu.mag.iter().map(|v| v.norm()))?;
    let unit = match m {
        2.0..=250.0 => return None,
        0.05..2.0 => "gauss",
        1e-3..0.05 => "millitesla",
        0.0..1e-3 => "tesla",
        250.0..2000.0 => "milligauss",
        _ => "nanotesla",
    };
    finding(
        &format!("columns {prefix}mag_*"),
        format!("{prefix}mag_* looks like {unit}: |m| = {m:.3e}"),
        "write microtesla: 25 to 65 µT outdoors",
    )
}

/// Largest magnitude of a value that the machine or its sensors can produce.
pub(super) fn single_values(log: &BendLog) -> Option<Finding> {
    let beyond = |column: &str, row: usize, value: f64, most: f64, unit: &str| {
        finding(
            &format!("line {}, column {column}", row + 2),
            format!("{value} {unit} is beyond what the machine can do (at most ±{most} {unit})"),
            "remove the row or correct the value",
        )
    };
    let scan = |columns: [&str; 3], values: &[Vector3<f64>], most: f64, unit: &str| {
        values
            .iter()
            .enumerate()
            .find_map(|(row, v)| (0..3).find(|&i| v[i].abs() > most).and_then(|i| beyond(columns[i], row, v[i], most, unit)))
    };
    let imu = |imu: &ImuColumns, prefix: &str| {
        let names = |quantity: &str| ["x", "y", "z"].map(|axis| format!("{prefix}{quantity}").replace('*', axis));
        let scan = |quantity: &str, values: &[Vector3<f64>], most: f64, unit: &str| {
            let names = names(quantity);
            scan([&names[0], &names[1], &names[2]], values, most, unit)
        };
        // ±32 g, ±4000 °/s, ±4.9 mT: the widest ranges of the parts in use
        scan("acc_*_m_s2", &imu.acc, 320.0, "m/s²")
            .or_else(|| scan("mag_*_ut", &imu.mag, 4900.0, "µT"))
            .or_else(|| scan("gyr_*_rad_s", &imu.gyr, 4000.0, "rad/s"))
    };
    scan(["piston1_mm", "piston2_mm", "piston3_mm"], &log.piston_mm, 60.0, "mm")
        .or_else(|| jump(log))
        .or_else(|| scan(["cmd_bend_deg", "cmd_dir_deg", "cmd_len_mm"], &log.command, 3600.0, "deg or mm"))
        .or_else(|| log.imu.as_ref().and_then(|i| imu(i, "")))
        .or_else(|| log.base.as_ref().and_then(|i| imu(i, "base_")))
        .or_else(|| scan(["pressure1_kpa", "pressure2_kpa", "pressure3_kpa"], log.pressure_kpa.as_ref()?, 300.0, "kPa"))
        .or_else(|| {
            log.temp_c
                .as_ref()?
                .iter()
                .enumerate()
                .find(|(_, t)| t.abs() > 150.0)
                .and_then(|(row, t)| beyond("temp_c", row, *t, 150.0, "°C"))
        })
}

/// A piston that is elsewhere from one row to the next: no motor here exceeds 200 mm/s.
fn jump(log: &BendLog) -> Option<Finding> {
    let far = |(k, w): (usize, &[Vector3<f64>])| {
        let most_mm = 5.0 + 200.0 * (log.t_s[k + 1] - log.t_s[k]);
        let step: Vector3<f64> = w[1] - w[0];
        (0..3).find(|&i| step[i].abs() > most_mm).map(|i| (k, i, step[i], most_mm))
    };
    let (k, i, step_mm, most_mm) = log.piston_mm.windows(2).enumerate().find_map(far)?;
    finding(
        &format!("line {}, column piston{}_mm", k + 3, i + 1),
        format!("the piston jumps by {step_mm:.1} mm from the row before, beyond what the machine can do (at most {most_mm:.1} mm)"),
        "remove the row or correct the value",
    )
}
