//! Wiring of the pistons, axes of the sensor, and units that only show in motion: rotations of the tip, measured and predicted.

use super::axes::{self, AGREES, Axes, BETTER, MOTION_RAD, Stray, Turn, correlation};
use super::values::{finding, finite};
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::model::{Geometry, Line};
use nalgebra::{UnitQuaternion, Vector3};
use std::ops::Range;

/// Longest window over which rotations are compared, s: much longer than the lag of a line, short against gyroscope drift.
const WINDOW_S: f64 = 2.0;
/// Command-to-motion delays that the comparison of rotations allows for, s.
const SHIFTS_S: [f64; 4] = [0.0, 0.15, 0.4, 0.8];
/// Rotations of the tip over windows, measured and predicted, as rotation vectors in the tip frame at the window's start, rad.
pub(super) struct Motion {
    measured: Vec<Vector3<f64>>,
    sensed: Vec<Turn>,
    /// Bellow length changes at the start and end of each window, mm, for each of [`SHIFTS_S`].
    bellows: [Vec<(Vector3<f64>, Vector3<f64>)>; SHIFTS_S.len()],
    /// Path of the predicted and of the measured rotation in windows with motion, rad; the latter from the gyroscope.
    path_rad: (f64, f64),
    /// Largest measured tilt from the first row, rad.
    tilt_rad: f64,
    geometry: Geometry,
}

impl Motion {
    pub(super) fn of(log: &BendLog, geometry: &Geometry, lines: &[Line; 3]) -> Self {
        let mut w_mm = Vector3::zeros();
        let bellow_mm: Vec<Vector3<f64>> = (log.piston_mm.iter())
            .map(|u| {
                w_mm = Vector3::from_fn(|i, _| lines[i].play(w_mm[i], u[i]));
                Vector3::from_fn(|i, _| lines[i].bellow_mm(w_mm[i]))
            })
            .collect();
        let mut motion = Self {
            measured: Vec::new(),
            sensed: Vec::new(),
            bellows: Default::default(),
            path_rad: (0.0, 0.0),
            tilt_rad: tilt_rad(log),
            geometry: *geometry,
        };
        let bias = rest_rate(log);
        let row_at = |t: f64| log.t_s.partition_point(|x| *x < t).min(log.t_s.len() - 1);
        let (mut from, end) = (0, log.t_s.len());
        while from + 1 < end {
            let to = row_at(log.t_s[from] + WINDOW_S);
            if let Some(turn) = measured_turn(log, from, to, &bias) {
                motion.measured.push(turn);
                let turn = gyroscope_turn(log, from, to, &bias);
                motion.sensed.push(Turn {
                    gyroscope: turn.unwrap_or_else(Vector3::zeros),
                    up: [from, to].map(|row| reading(log, row, |imu| &imu.acc)),
                    north: [from, to].map(|row| reading(log, row, |imu| &imu.mag)),
                });
                for (shift_s, pairs) in SHIFTS_S.iter().zip(&mut motion.bellows) {
                    let back = |k: usize| bellow_mm[row_at(log.t_s[k] - shift_s)];
                    pairs.push((back(from), back(to)));
                }
                motion.add_path(log, from..to, &bellow_mm, &bias);
            }
            from = to.max(from + 1);
        }
        motion
    }

    fn add_path(
        &mut self,
        log: &BendLog,
        rows: Range<usize>,
        bellow_mm: &[Vector3<f64>],
        bias: &Vector3<f64>,
    ) {
        let bend = |k: usize| self.geometry.shape(&bellow_mm[k]).bend.0;
        let predicted: f64 = rows.clone().map(|k| (bend(k + 1) - bend(k)).norm()).sum();
        let Some(imu) = &log.imu else { return };
        let rate = |k: usize| Some((imu.gyr[k] - bias).norm()).filter(|_| imu.gyr[k].x.is_finite());
        let turned = |k: usize| rate(k).unwrap_or(0.0) * (log.t_s[k + 1] - log.t_s[k]);
        if predicted > MOTION_RAD {
            self.path_rad.0 += predicted;
            self.path_rad.1 += rows.map(turned).sum::<f64>();
        }
    }

    /// Correlation of measured rotations with those predicted when the pistons are wired as `wiring` says, the best over the shifts;
    /// `None` where too little moves.
    fn agreement(&self, measured: &[Vector3<f64>], wiring: &Wiring) -> Option<f64> {
        let rotation =
            |q: &Vector3<f64>| self.geometry.shape(&wiring.apply(q)).bend.rotation().quat();
        let over = |pairs: &Vec<(Vector3<f64>, Vector3<f64>)>| {
            let turn = |(a, b): &(Vector3<f64>, Vector3<f64>)| {
                (rotation(a).inverse() * rotation(b)).scaled_axis()
            };
            correlation(measured.iter().copied().zip(pairs.iter().map(turn)))
        };
        self.bellows.iter().filter_map(over).max_by(f64::total_cmp)
    }

    /// Pistons in metres: numbers below a tenth while the tip tilts.
    pub(super) fn piston_unit(&self, log: &BendLog) -> Option<String> {
        let most = log.piston_mm.iter().map(|p| p.amax()).fold(0.0, f64::max);
        if !(most > 0.0 && most < 0.1 && self.tilt_rad > 0.14) {
            return None;
        }
        let tilt_deg = self.tilt_rad.to_degrees();
        let text = format!(
            "piston*_mm looks like m: the tip tilts by {tilt_deg:.0}° and the largest piston position is {most:.4}"
        );
        finding("columns piston*_mm", text, "write mm")
    }

    /// Rates in degrees per second: the gyroscope's path is 57 times the one that the pistons drive.
    pub(super) fn rate_unit(&self) -> Option<String> {
        let (predicted, measured) = self.path_rad;
        if predicted < 4.0 * MOTION_RAD || measured < 12.0 * predicted {
            return None;
        }
        let ratio = measured / predicted;
        let text = format!(
            "gyr_* looks like °/s: the gyroscope turns {ratio:.0} times as far as the pistons drive the tip"
        );
        finding("columns gyr_*", text, "write rad/s")
    }

    /// Sensors whose axes are not those of the tip, by each other.
    pub(super) fn axes(&self) -> Option<String> {
        told(axes::stray(&self.sensed, |axes| self.driven(axes))?)
    }

    /// Sensors that all have the same axes, but not those of the tip.
    pub(super) fn turned(&self) -> Option<String> {
        told(axes::turned(|axes| self.driven(axes))?)
    }

    /// Correlation of the gyroscope's turns with those that the pistons drive, if its axes are these.
    fn driven(&self, axes: &Axes) -> Option<f64> {
        let turns = self.sensed.iter().map(|turn| axes.apply(&turn.gyroscope));
        self.agreement(&turns.collect::<Vec<_>>(), &AS_WIRED)
    }

    /// Pistons wired otherwise than the model says: another wiring explains the tip's rotations, and this one does not. A single
    /// reversed piston leaves a correlation of 0.45, an exchange 0 and all reversed −1.
    pub(super) fn wiring(&self) -> Option<String> {
        let agreement = |wiring| self.agreement(&self.measured, wiring);
        let as_wired = agreement(&AS_WIRED)?;
        let scores = OTHERS.iter().filter_map(|w| Some((agreement(w)?, w)));
        let (best, Wiring { says, mend, .. }) = scores.max_by(|a, b| a.0.total_cmp(&b.0))?;
        if best < AGREES || best - as_wired < BETTER {
            return None;
        }
        let text = format!(
            "{says}: the tip's rotations correlate with the pistons by {as_wired:.2}, and by {best:.2} if so"
        );
        finding("columns piston*_mm", text, mend)
    }
}

/// The finding about stray axes.
fn told((columns, says): Stray) -> Option<String> {
    let text = format!("{says}: sensors and pistons turn in different directions");
    let mend = "correct the columns of each sensor that has these axes, so that x, y, z are those of the tip";
    finding(&format!("columns {columns}"), text, mend)
}

/// A reading in a row; zero without a sample.
fn reading(
    log: &BendLog,
    row: usize,
    of: impl Fn(&ImuColumns) -> &Vec<Vector3<f64>>,
) -> Vector3<f64> {
    let reading = log.imu.as_ref().and_then(|imu| of(imu).get(row));
    reading
        .copied()
        .filter(finite)
        .unwrap_or_else(Vector3::zeros)
}

/// Mean rate over the rows before the first piston moves, rad/s: the gyroscope's constant bias.
fn rest_rate(log: &BendLog) -> Vector3<f64> {
    let gyr = log.imu.as_ref().map_or(&[][..], |imu| &imu.gyr);
    let rows = log.piston_mm.iter().zip(gyr);
    let still = rows.take_while(|(p, _)| **p == log.piston_mm[0]);
    let rates: Vec<_> = still.map(|(_, rate)| rate).filter(|r| finite(r)).collect();
    rates.iter().fold(Vector3::zeros(), |sum, r| sum + **r) / rates.len().max(1) as f64
}

/// Rotation of the tip from row `from` to row `to`, by the tracker or else by the gyroscope.
fn measured_turn(
    log: &BendLog,
    from: usize,
    to: usize,
    bias: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    if let Some(reference) = &log.reference {
        return Some((reference[from]?.inverse() * reference[to]?).scaled_axis());
    }
    gyroscope_turn(log, from, to, bias)
}

/// Rotation of the tip from row `from` to row `to` by the gyroscope; `None` without a sample.
fn gyroscope_turn(
    log: &BendLog,
    from: usize,
    to: usize,
    bias: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let imu = log.imu.as_ref()?;
    let (mut turned, mut held) = (UnitQuaternion::identity(), Vector3::zeros());
    let mut samples = 0;
    for k in from..to {
        // a row without a sample goes on at the rate of the one before
        if finite(&imu.gyr[k]) {
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
        let mut finite = directions.filter(|v| finite(v) && v.norm() > 0.0);
        let Some(first) = finite.next() else {
            return 0.0;
        };
        let mut angles: Vec<f64> = finite.map(|v| first.angle(&v)).collect();
        angles.sort_by(f64::total_cmp);
        // the largest but for one row in a hundred, which noise may have thrown off
        angles.get(angles.len() * 99 / 100).copied().unwrap_or(0.0)
    };
    let orientations = log.reference.iter().flatten().flatten();
    let tracker = orientations.map(|q| q * Vector3::z());
    let gravity = log.imu.iter().flat_map(|imu| imu.acc.iter().copied());
    largest(&mut { tracker }).max(largest(&mut { gravity }))
}

/// A way in which pistons may be wired.
#[derive(Clone, Copy)]
struct Wiring {
    /// Counted piston that drives each bellow, and its sign.
    from: [usize; 3],
    sign: [f64; 3],
    /// What is said about it.
    says: &'static str,
    mend: &'static str,
}

impl Wiring {
    fn apply(&self, q_mm: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.sign[i] * q_mm[self.from[i]])
    }
}

const EXCHANGE: &str = "exchange the columns, or the lines, so that piston i drives bellow i";
const REVERSE: &str = "change the sign: positive elongates the bellow";
const SHIFTED: &str = "piston1_mm, piston2_mm and piston3_mm look shifted by one";
const AS_WIRED: Wiring = Wiring {
    from: [0, 1, 2],
    sign: [1.0; 3],
    says: "",
    mend: EXCHANGE,
};
const OTHERS: [Wiring; 9] = [
    exchanged([1, 0, 2], "piston1_mm and piston2_mm look exchanged"),
    exchanged([2, 1, 0], "piston1_mm and piston3_mm look exchanged"),
    exchanged([0, 2, 1], "piston2_mm and piston3_mm look exchanged"),
    exchanged([1, 2, 0], SHIFTED),
    exchanged([2, 0, 1], SHIFTED),
    reversed(
        [-1.0, 1.0, 1.0],
        "piston1_mm looks like it has the other sign",
    ),
    reversed(
        [1.0, -1.0, 1.0],
        "piston2_mm looks like it has the other sign",
    ),
    reversed(
        [1.0, 1.0, -1.0],
        "piston3_mm looks like it has the other sign",
    ),
    reversed([-1.0; 3], "all pistons look like they have the other sign"),
];

const fn exchanged(from: [usize; 3], says: &'static str) -> Wiring {
    let mut wiring = AS_WIRED;
    (wiring.from, wiring.says) = (from, says);
    wiring
}

const fn reversed(sign: [f64; 3], says: &'static str) -> Wiring {
    let mut wiring = AS_WIRED;
    (wiring.sign, wiring.says, wiring.mend) = (sign, says, REVERSE);
    wiring
}
