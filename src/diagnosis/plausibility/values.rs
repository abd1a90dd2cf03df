//! Units of the clock and of the sensors, and single values beyond what the machine can do.

use crate::log::bend_log::{ACC, BendLog, COMMAND, GYR, ImuColumns, MAG, PISTON, PRESSURE};
use crate::log::table::median;
use nalgebra::Vector3;

/// The columns, and perhaps the line, at fault, what the values look like, and how to mend the log.
pub(super) fn finding(place: &str, finding: String, mend: &str) -> Option<String> {
    Some(format!("{place}: {finding}; {mend}"))
}

/// How to mend a single value.
const CORRECT: &str = "remove the row or correct the value";

/// Whether a vector has no missing component.
pub(super) fn finite(v: &Vector3<f64>) -> bool {
    v.iter().all(|x| x.is_finite())
}

fn periods(log: &BendLog) -> impl Iterator<Item = f64> {
    log.t_s.windows(2).map(|w| w[1] - w[0])
}

/// A clock in milliseconds or microseconds: rows far apart, and pistons that creep where they should run.
pub(super) fn clock_unit(log: &BendLog) -> Option<String> {
    let period_s = median(periods(log))?;
    let steps = log.piston_mm.windows(2).zip(periods(log));
    let speeds_mm_s = steps.map(|(p, dt)| (p[1] - p[0]).amax() / dt);
    let speed_mm_s = speeds_mm_s.fold(0.0, f64::max);
    // at 2 kHz and 1 mm/s a clock in milliseconds gives 0.5 and 0.001
    if period_s < 0.4 || speed_mm_s == 0.0 || speed_mm_s > 0.3 {
        return None;
    }
    let part = if speed_mm_s > 3e-4 { "milli" } else { "micro" };
    let text = format!(
        "looks like {part}seconds: rows are {period_s} apart and no piston moves faster than {speed_mm_s:.2e} mm per unit"
    );
    finding("column time_s", text, "write seconds")
}

/// Accelerometer and magnetometer by the magnitude that they have most of the time.
pub(super) fn sensor_units(imu: &ImuColumns, prefix: &str) -> Option<String> {
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
            let text = format!("{prefix}acc_* looks like {unit}: at rest |a| = {a:.3}");
            return finding(&place, text, "write m/s²: 9.81 at rest");
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
    let place = format!("columns {prefix}mag_*");
    let text = format!("{prefix}mag_* looks like {unit}: |m| = {m:.3e}");
    finding(&place, text, "write microtesla: 25 to 65 µT outdoors")
}

/// Largest magnitude of a value that the machine or its sensors can produce.
pub(super) fn single_values(log: &BendLog) -> Option<String> {
    let beyond = |column: &str, row: usize, value: f64, most: f64, unit: &str| {
        let place = format!("line {}, column {column}", row + 2);
        let text =
            format!("{value} {unit} is beyond what the machine can do (at most ±{most} {unit})");
        finding(&place, text, CORRECT)
    };
    let scan = |columns: [&str; 3], values: &[Vector3<f64>], most: f64, unit: &str| {
        let mut rows = values.iter().enumerate();
        let (row, i) = rows.find_map(|(k, v)| Some((k, v.iter().position(|x| x.abs() > most)?)))?;
        beyond(columns[i], row, values[row][i], most, unit)
    };
    let imu = |imu: &Option<ImuColumns>, prefix: &str| {
        let imu = imu.as_ref()?;
        let scan = |columns: [&str; 3], values: &[Vector3<f64>], most, unit| {
            let [x, y, z] = columns.map(|column| format!("{prefix}{column}"));
            scan([&x, &y, &z], values, most, unit)
        };
        // ±32 g, ±4000 °/s, ±4.9 mT: the widest ranges of the parts in use
        scan(ACC, &imu.acc, 320.0, "m/s²")
            .or_else(|| scan(MAG, &imu.mag, 4900.0, "µT"))
            .or_else(|| scan(GYR, &imu.gyr, 4000.0, "rad/s"))
    };
    let pressures = log.pressure_kpa.as_deref().unwrap_or_default();
    let mut temperatures = log.temp_c.iter().flatten().enumerate();
    scan(PISTON, &log.piston_mm, 60.0, "mm")
        .or_else(|| jump(log))
        .or_else(|| scan(COMMAND, &log.command, 3600.0, "deg or mm"))
        .or_else(|| imu(&log.imu, ""))
        .or_else(|| imu(&log.base, "base_"))
        .or_else(|| scan(PRESSURE, pressures, 300.0, "kPa"))
        .or_else(|| {
            let (row, t) = temperatures.find(|(_, t)| t.abs() > 150.0)?;
            beyond("temp_c", row, *t, 150.0, "°C")
        })
}

/// A piston that is elsewhere from one row to the next: no motor here exceeds 200 mm/s.
fn jump(log: &BendLog) -> Option<String> {
    let far = |(k, w): (usize, &[Vector3<f64>])| {
        let most_mm = 5.0 + 200.0 * (log.t_s[k + 1] - log.t_s[k]);
        let step: Vector3<f64> = w[1] - w[0];
        let i = (0..3).find(|&i| step[i].abs() > most_mm)?;
        Some((k, i, step[i], most_mm))
    };
    let (k, i, step_mm, most_mm) = log.piston_mm.windows(2).enumerate().find_map(far)?;
    let place = format!("line {}, column {}", k + 3, PISTON[i]);
    let text = format!(
        "the piston jumps by {step_mm:.1} mm from the row before, beyond what the machine can do (at most {most_mm:.1} mm)"
    );
    finding(&place, text, CORRECT)
}
