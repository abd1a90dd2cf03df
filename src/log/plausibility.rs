//! Refuses a bend log whose units or wiring cannot be right, before any diagnosis gives it a physical cause.
//!
//! Three kinds of check, in this order:
//!
//! * units, from the median magnitude of each sensor and from the piston speed: a still accelerometer reads 9.81 m/s², the
//!   Earth's field is 25 to 65 µT (Alken et al. 2021, IGRF-13), the pistons move millimetres in seconds;
//! * single values beyond what the machine or the sensor can do;
//! * wiring, from the rotations of the tip over windows of two seconds: measured by the tracker or integrated from the
//!   gyroscope on one side, predicted from the pistons by the nominal model on the other. Exchanged pistons or reversed signs
//!   turn the prediction in a way that no effect of the catalogue does.

use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::arc::Geometry;
use crate::model::transmission::Line;
use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

/// A log whose units or wiring cannot be right.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{file}, {place}: {finding}; {mend}")]
pub struct Implausible {
    /// Name of the file.
    pub file: String,
    /// Column, with the line where one value is at fault.
    pub place: String,
    /// What the values look like.
    pub finding: String,
    /// How to mend the log.
    pub mend: String,
}

/// Longest window over which rotations are compared, s: much longer than the lag of a line, short against gyroscope drift.
const WINDOW_S: f64 = 2.0;
/// Command-to-motion delays that the comparison of rotations allows for, s.
const SHIFTS_S: [f64; 4] = [0.0, 0.15, 0.4, 0.8];
/// Rotation within a window that counts as motion, rad (5°).
const MOTION_RAD: f64 = 0.09;
/// Windows with motion below which the wiring is not judged.
const WINDOWS_MIN: usize = 8;

/// Checks a log against the nominal model with these transmission lines.
///
/// # Errors
/// [`Implausible`] for the first finding.
pub fn check(log: &BendLog, geometry: &Geometry, lines: &[Line; 3]) -> Result<(), Implausible> {
    let refuse = |(place, finding, mend): Finding| Implausible { file: log.file.clone(), place, finding, mend };
    let first = clock_unit(log)
        .or_else(|| log.imu.as_ref().and_then(|imu| sensor_units(imu, "")))
        .or_else(|| log.base.as_ref().and_then(|imu| sensor_units(imu, "base_")))
        .or_else(|| single_values(log));
    if let Some(finding) = first {
        return Err(refuse(finding));
    }
    let motion = Motion::of(log, geometry, lines);
    match piston_unit(log, &motion).or_else(|| rate_unit(&motion)).or_else(|| wiring(&motion)) {
        Some(finding) => Err(refuse(finding)),
        None => Ok(()),
    }
}

/// Place, finding, mend.
type Finding = (String, String, String);

fn finding(place: &str, finding: String, mend: &str) -> Option<Finding> {
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
fn clock_unit(log: &BendLog) -> Option<Finding> {
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
fn sensor_units(imu: &ImuColumns, prefix: &str) -> Option<Finding> {
    if let Some(a) = median(imu.acc.iter().map(|v| v.norm())) {
        let unit = match a {
            6.0..=14.0 => None,
            0.5..=2.0 => Some("g"),
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
fn single_values(log: &BendLog) -> Option<Finding> {
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

/// Rotations of the tip over windows, measured and predicted, as rotation vectors in the tip frame at the window's start, rad.
struct Motion {
    measured: Vec<Vector3<f64>>,
    /// Bellow length changes at the start and end of each window, mm, for each of [`SHIFTS_S`].
    bellows: [Vec<(Vector3<f64>, Vector3<f64>)>; SHIFTS_S.len()],
    /// Path of the predicted and of the measured rotation in windows with motion, rad; the latter from the gyroscope.
    path_rad: (f64, f64),
    /// Largest measured tilt from the first row, rad.
    tilt_rad: f64,
    geometry: Geometry,
}

impl Motion {
    fn of(log: &BendLog, geometry: &Geometry, lines: &[Line; 3]) -> Self {
        let mut w_mm = Vector3::zeros();
        let bellow_mm: Vec<Vector3<f64>> = (log.piston_mm.iter())
            .map(|u| {
                w_mm = Vector3::from_fn(|i, _| lines[i].play(w_mm[i], u[i]));
                Vector3::from_fn(|i, _| lines[i].bellow_mm(w_mm[i]))
            })
            .collect();
        let mut motion =
            Self { measured: Vec::new(), bellows: Default::default(), path_rad: (0.0, 0.0), tilt_rad: tilt_rad(log), geometry: *geometry };
        let bias = rest_rate(log);
        let row_at = |t: f64| log.t_s.partition_point(|x| *x < t).min(log.t_s.len() - 1);
        let (mut from, end) = (0, log.t_s.len());
        while from + 1 < end {
            let to = row_at(log.t_s[from] + WINDOW_S);
            if let Some(turn) = measured_turn(log, from, to, &bias) {
                motion.measured.push(turn);
                for (shift_s, pairs) in SHIFTS_S.iter().zip(&mut motion.bellows) {
                    let back = |k: usize| bellow_mm[row_at(log.t_s[k] - shift_s)];
                    pairs.push((back(from), back(to)));
                }
                motion.add_path(log, from, to, &bellow_mm, &bias);
            }
            from = to.max(from + 1);
        }
        motion
    }

    fn add_path(&mut self, log: &BendLog, from: usize, to: usize, bellow_mm: &[Vector3<f64>], bias: &Vector3<f64>) {
        let bend = |k: usize| self.geometry.shape(&bellow_mm[k]).bend.0;
        let predicted: f64 = (from..to).map(|k| (bend(k + 1) - bend(k)).norm()).sum();
        let Some(imu) = &log.imu else { return };
        let turned = |k: usize| {
            let rate: Vector3<f64> = imu.gyr[k] - bias;
            if rate.x.is_finite() { rate.norm() * (log.t_s[k + 1] - log.t_s[k]) } else { 0.0 }
        };
        if predicted > MOTION_RAD {
            self.path_rad.0 += predicted;
            self.path_rad.1 += (from..to).map(turned).sum::<f64>();
        }
    }

    /// Correlation of measured and predicted rotations when the pistons are wired as `wiring` says, the best over the shifts;
    /// `None` where too little moves.
    fn agreement(&self, wiring: &Wiring) -> Option<f64> {
        let rotation = |q: &Vector3<f64>| self.geometry.shape(&wiring.apply(q)).bend.rotation().quat();
        let over = |pairs: &Vec<(Vector3<f64>, Vector3<f64>)>| {
            let (mut mp, mut mm, mut pp, mut windows) = (0.0, 0.0, 0.0, 0);
            for (measured, (a, b)) in self.measured.iter().zip(pairs) {
                let predicted = (rotation(a).inverse() * rotation(b)).scaled_axis();
                if measured.norm().max(predicted.norm()) > MOTION_RAD {
                    mp += measured.dot(&predicted);
                    mm += measured.norm_squared();
                    pp += predicted.norm_squared();
                    windows += 1;
                }
            }
            (windows >= WINDOWS_MIN && mm > 0.0 && pp > 0.0).then(|| mp / (mm * pp).sqrt())
        };
        self.bellows.iter().filter_map(over).max_by(f64::total_cmp)
    }
}

/// Mean rate over the rows before the first piston moves, rad/s: the gyroscope's constant bias.
fn rest_rate(log: &BendLog) -> Vector3<f64> {
    let Some(imu) = &log.imu else { return Vector3::zeros() };
    let still = log.piston_mm.iter().take_while(|p| **p == log.piston_mm[0]).count();
    let rates: Vec<&Vector3<f64>> = imu.gyr[..still].iter().filter(|r| r.iter().all(|x| x.is_finite())).collect();
    rates.iter().fold(Vector3::zeros(), |sum, r| sum + **r) / rates.len().max(1) as f64
}

/// Rotation of the tip from row `from` to row `to`, by the tracker or else by the gyroscope.
fn measured_turn(log: &BendLog, from: usize, to: usize, bias: &Vector3<f64>) -> Option<Vector3<f64>> {
    if let Some(reference) = &log.reference {
        return Some((reference[from]?.inverse() * reference[to]?).scaled_axis());
    }
    let imu = log.imu.as_ref()?;
    let (mut turned, mut held) = (UnitQuaternion::identity(), Vector3::zeros());
    let mut samples = 0;
    for k in from..to {
        // a row without a sample goes on at the rate of the one before
        if imu.gyr[k].iter().all(|x| x.is_finite()) {
            held = imu.gyr[k] - bias;
            samples += 1;
        }
        turned *= UnitQuaternion::from_scaled_axis(held * (log.t_s[k + 1] - log.t_s[k]));
    }
    (samples > 0).then(|| turned.scaled_axis())
}

/// Largest angle of the tracker's tip axis, or of gravity in the sensor, from where it was at first, rad.
fn tilt_rad(log: &BendLog) -> f64 {
    let largest = |directions: &mut dyn Iterator<Item = Vector3<f64>>| {
        let mut finite = directions.filter(|v| v.iter().all(|x| x.is_finite()) && v.norm() > 0.0);
        let first = finite.next();
        let mut angles: Vec<f64> = first.map_or_else(Vec::new, |f| finite.map(|v| f.angle(&v)).collect());
        // the largest but for one row in a hundred, which noise may have thrown off
        let rank = angles.len() * 99 / 100;
        if angles.is_empty() { 0.0 } else { *angles.select_nth_unstable_by(rank, f64::total_cmp).1 }
    };
    let tracker = log.reference.iter().flatten().flatten().map(|q| q * Vector3::z());
    let gravity = log.imu.iter().flat_map(|imu| imu.acc.iter().copied());
    largest(&mut { tracker }).max(largest(&mut { gravity }))
}

/// Pistons in metres: numbers below a tenth while the tip tilts.
fn piston_unit(log: &BendLog, motion: &Motion) -> Option<Finding> {
    let most = log.piston_mm.iter().map(|p| p.amax()).fold(0.0, f64::max);
    (most > 0.0 && most < 0.1 && motion.tilt_rad > 0.14).then(|| {
        let tilt_deg = motion.tilt_rad.to_degrees();
        let finding = format!("piston*_mm looks like m: the tip tilts by {tilt_deg:.0}° and the largest piston position is {most:.4}");
        ("columns piston*_mm".to_owned(), finding, "write mm".to_owned())
    })
}

/// Rates in degrees per second: the gyroscope's path is 57 times the one that the pistons drive.
fn rate_unit(motion: &Motion) -> Option<Finding> {
    let (predicted, measured) = motion.path_rad;
    if predicted < 4.0 * MOTION_RAD || measured < 12.0 * predicted {
        return None;
    }
    let ratio = measured / predicted;
    finding(
        "columns gyr_*",
        format!("gyr_* looks like °/s: the gyroscope turns {ratio:.0} times as far as the pistons drive the tip"),
        "write rad/s",
    )
}

/// A way in which pistons may be wired: which counted piston drives each bellow, and with which sign.
struct Wiring {
    from: [usize; 3],
    sign: [f64; 3],
    says: &'static str,
    mend: &'static str,
}

impl Wiring {
    fn apply(&self, q_mm: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.sign[i] * q_mm[self.from[i]])
    }
}

const AS_WIRED: [usize; 3] = [0, 1, 2];
const PLUS: [f64; 3] = [1.0; 3];
const EXCHANGE: &str = "exchange the columns, or the lines, so that piston i drives bellow i";
const REVERSE: &str = "change the sign: positive elongates the bellow";
const WIRINGS: [Wiring; 9] = [
    Wiring { from: [1, 0, 2], sign: PLUS, says: "piston1_mm and piston2_mm look exchanged", mend: EXCHANGE },
    Wiring { from: [2, 1, 0], sign: PLUS, says: "piston1_mm and piston3_mm look exchanged", mend: EXCHANGE },
    Wiring { from: [0, 2, 1], sign: PLUS, says: "piston2_mm and piston3_mm look exchanged", mend: EXCHANGE },
    Wiring { from: [1, 2, 0], sign: PLUS, says: "piston1_mm, piston2_mm and piston3_mm look shifted by one", mend: EXCHANGE },
    Wiring { from: [2, 0, 1], sign: PLUS, says: "piston1_mm, piston2_mm and piston3_mm look shifted by one", mend: EXCHANGE },
    Wiring { from: AS_WIRED, sign: [-1.0, 1.0, 1.0], says: "piston1_mm looks like it has the other sign", mend: REVERSE },
    Wiring { from: AS_WIRED, sign: [1.0, -1.0, 1.0], says: "piston2_mm looks like it has the other sign", mend: REVERSE },
    Wiring { from: AS_WIRED, sign: [1.0, 1.0, -1.0], says: "piston3_mm looks like it has the other sign", mend: REVERSE },
    Wiring { from: AS_WIRED, sign: [-1.0; 3], says: "all pistons look like they have the other sign", mend: REVERSE },
];

/// Pistons wired otherwise than the model says: another wiring explains the tip's rotations, and this one does not. A single
/// reversed piston leaves a correlation of 0.45, an exchange 0, all reversed −1; the effects of the catalogue leave 0.8 and more.
fn wiring(motion: &Motion) -> Option<Finding> {
    let nominal = Wiring { from: AS_WIRED, sign: PLUS, says: "", mend: "" };
    let as_wired = motion.agreement(&nominal)?;
    let score = |w: &'static Wiring| motion.agreement(w).map(|a| (a, w));
    let (best, other) = WIRINGS.iter().filter_map(score).max_by(|a, b| a.0.total_cmp(&b.0))?;
    if best < 0.7 || best - as_wired < 0.25 {
        return None;
    }
    let text = format!("{}: the tip's rotations correlate with the pistons by {as_wired:.2}, and by {best:.2} if so", other.says);
    finding("columns piston*_mm", text, other.mend)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::arc::Shape;
    use crate::model::bend::Bend;
    use crate::primitives::units::Mm;

    fn lines() -> [Line; 3] {
        [2.2, 2.5, 2.2].map(|k_epsilon| Line { k_epsilon, k_lambda_mm: 0.9 })
    }

    /// Two minutes of poses in twelve directions, 100 rows a second, of a tip that follows the nominal model.
    fn sound() -> BendLog {
        let (geometry, lines) = (Geometry::default(), lines());
        let mut log = BendLog { file: "x.csv".to_owned(), ..BendLog::default() };
        let mut imu = ImuColumns { acc: Vec::new(), gyr: Vec::new(), mag: Vec::new() };
        let (mut at, mut before) = (nalgebra::Vector2::zeros(), UnitQuaternion::identity());
        let base = UnitQuaternion::from_euler_angles(0.4, -0.3, 1.0);
        for k in 0..12_000 {
            let t_s = f64::from(k + 1) * 0.01;
            let pose = (t_s / 3.0).floor();
            let target = if t_s < 3.0 { Bend::STRAIGHT } else { Bend::from_deg(60.0, pose * 150.0) };
            at += (target.0 - at) * 0.02;
            let turn = Bend(at).rotation().quat();
            let q_mm = geometry.lengths(&Shape { bend: Bend(at), length: Mm(geometry.rest_length_mm) });
            log.t_s.push(t_s);
            log.command.push(Vector3::new(target.beta().to_degrees(), target.delta().to_degrees(), 20.0));
            log.piston_mm.push(Vector3::from_fn(|i, _| lines[i].piston_mm(q_mm[i], 0.0)));
            imu.acc.push((base * turn).inverse() * Vector3::new(0.0, 0.0, 9.81));
            imu.mag.push((base * turn).inverse() * Vector3::new(20.0, 0.0, -43.0));
            imu.gyr.push((before.inverse() * turn).scaled_axis() / 0.01 + Vector3::new(0.01, -0.02, 0.005));
            before = turn;
        }
        log.imu = Some(imu);
        log
    }

    fn verdict(change: impl Fn(&mut BendLog)) -> String {
        let mut log = sound();
        change(&mut log);
        check(&log, &Geometry::default(), &lines()).map_or_else(|e| e.to_string(), |()| "sound".to_owned())
    }

    fn imu(log: &mut BendLog) -> &mut ImuColumns {
        log.imu.as_mut().unwrap()
    }

    #[test]
    fn a_sound_log_passes() {
        assert_eq!(verdict(|_| ()), "sound");
        assert_eq!(verdict(|log| log.imu = None), "sound", "nothing to compare the pistons with");
    }

    #[test]
    fn units_are_recognised() {
        let scale = |v: &mut Vec<Vector3<f64>>, by: f64| v.iter_mut().for_each(|x| *x *= by);
        let cases: [(&str, &dyn Fn(&mut BendLog)); 8] = [
            ("acc_* looks like g: at rest |a| = 1.0", &|log| scale(&mut imu(log).acc, 1.0 / 9.81)),
            ("looks like gauss", &|log| scale(&mut imu(log).mag, 0.01)),
            ("looks like tesla", &|log| scale(&mut imu(log).mag, 1e-6)),
            ("looks like nanotesla", &|log| scale(&mut imu(log).mag, 1e3)),
            ("looks like °/s", &|log| scale(&mut imu(log).gyr, 180.0 / std::f64::consts::PI)),
            ("looks like milliseconds", &|log| log.t_s.iter_mut().for_each(|t| *t *= 1e3)),
            ("looks like microseconds", &|log| log.t_s.iter_mut().for_each(|t| *t *= 1e6)),
            ("piston*_mm looks like m", &|log| scale(&mut log.piston_mm, 1e-3)),
        ];
        for (words, change) in cases {
            let said = verdict(change);
            assert!(said.starts_with("x.csv, column") && said.contains(words), "{words}: {said}");
        }
    }

    #[test]
    fn wiring_is_recognised() {
        let each = |log: &mut BendLog, f: &dyn Fn(&mut Vector3<f64>)| log.piston_mm.iter_mut().for_each(f);
        let cases: [(&str, &dyn Fn(&mut Vector3<f64>)); 6] = [
            ("piston1_mm and piston2_mm look exchanged", &|p| p.swap_rows(0, 1)),
            ("piston1_mm and piston3_mm look exchanged", &|p| p.swap_rows(0, 2)),
            ("piston2_mm and piston3_mm look exchanged", &|p| p.swap_rows(1, 2)),
            ("piston1_mm looks like it has the other sign", &|p| p.x = -p.x),
            ("piston3_mm looks like it has the other sign", &|p| p.z = -p.z),
            ("all pistons look like they have the other sign", &|p| *p = -*p),
        ];
        for (words, change) in cases {
            let said = verdict(|log| each(log, change));
            assert!(said.contains(words), "{words}: {said}");
        }
    }

    #[test]
    fn single_values_are_named_with_line_and_column() {
        let said = verdict(|log| log.piston_mm[99].y = 1e9);
        assert!(said.contains("line 101, column piston2_mm: 1000000000 mm is beyond"), "{said}");
        let said = verdict(|log| log.piston_mm[99].y = 25.0);
        assert!(said.contains("line 101, column piston2_mm: the piston jumps by"), "{said}");
        let said = verdict(|log| imu(log).gyr[7].z = -1e7);
        assert!(said.contains("line 9, column gyr_z_rad_s"), "{said}");
    }
}
