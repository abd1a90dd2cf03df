//! Rows of a log averaged in bins of 50 ms, or of 200 ms in long holds.

use crate::diagnosis::tip::observed::{PerQuantity, Quantity};
use crate::log::bend_log::{BendLog, ImuColumns};
use crate::log::table::median;
use nalgebra::{Matrix3, Vector3};
use std::borrow::Cow;

/// Length of a bin, s.
pub const BIN_S: f64 = 0.05;
/// Length of a bin in a long hold, s.
const HOLD_BIN_S: f64 = 0.2;
/// Idle time after which a hold counts as long, s.
const HOLD_AFTER_S: f64 = 1.5;
/// Time of a long log that is compared with the model, s.
const COMPARED_S: f64 = 600.0;
/// Length of a stretch of it, s: two blocks of the scores, one in each fold.
const STRETCH_S: f64 = 24.0;
/// Idle time of the first row, s: the pistons have stood long before the log begins.
const IDLE_BEFORE_S: f64 = 10.0;
/// Gravity, m/s².
pub const G_M_S2: f64 = 9.80665;
/// Median of a chi-squared variable with three degrees of freedom.
const CHI2_3_MEDIAN: f64 = 2.366;

/// One bin.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bin {
    /// First row and one past the last.
    pub rows: (usize, usize),
    /// Index of the bin's middle among the instants of the log.
    pub at: usize,
    /// Time of the middle, s.
    pub t_s: f64,
    /// Length, s.
    pub lasting_s: f64,
    /// Mean tracker orientation as a matrix, tip → base; NaN where missing.
    pub reference: Matrix3<f64>,
    /// Mean specific force, m/s²; NaN where missing.
    pub acc: Vector3<f64>,
    /// Mean field, µT; NaN where missing.
    pub mag: Vector3<f64>,
    /// Mean rate since the middle of the bin before, rad/s; NaN where missing.
    pub gyr: Vector3<f64>,
    /// Rotation of the base since the initial rest as the IMU on it measured it: base now → base at rest.
    pub base: Matrix3<f64>,
    /// 1/σ of each quantity's residual, 1/rad (gyroscope: s/rad); 0 where missing.
    pub weight: PerQuantity<f64>,
    /// Time since a piston last moved, s.
    pub idle_s: f64,
    /// Speed of the fastest piston, mm/s.
    pub speed_mm_s: f64,
}

/// The pistons at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Row {
    /// Time, s.
    pub t_s: f64,
    /// Counted pistons, mm.
    pub piston_mm: Vector3<f64>,
    /// Time since a piston last moved, s.
    pub idle_s: f64,
}

/// The rows of a log.
pub fn rows(log: &BendLog) -> Vec<Row> {
    let mut out: Vec<Row> = Vec::with_capacity(log.t_s.len());
    for (&t_s, &piston_mm) in log.t_s.iter().zip(&log.piston_mm) {
        let idle_s = out.last().map_or(IDLE_BEFORE_S, |last| {
            if piston_mm == last.piston_mm {
                last.idle_s + t_s - last.t_s
            } else {
                0.0
            }
        });
        out.push(Row {
            t_s,
            piston_mm,
            idle_s,
        });
    }
    out
}

/// Whether a piston starts, stops or reverses at row `k`, which has neighbours.
pub fn turns(rows: &[Row], k: usize) -> bool {
    let [before, after] = [k - 1, k].map(|k| rows[k + 1].piston_mm - rows[k].piston_mm);
    let mut lines = before.iter().zip(&after);
    lines.any(|(a, b)| a * b <= 0.0 && a != b)
}

/// Counted pistons at time `t_s`, interpolated linearly between rows `k` and `k + 1`.
pub fn piston_after(rows: &[Row], k: usize, t_s: f64) -> Vector3<f64> {
    let (here, Some(next)) = (rows[k], rows.get(k + 1)) else {
        return rows[k].piston_mm;
    };
    let share = ((t_s - here.t_s) / (next.t_s - here.t_s)).clamp(0.0, 1.0);
    here.piston_mm.lerp(&next.piston_mm, share)
}

/// Mean of the values that are not missing.
pub fn mean(values: impl Iterator<Item = Vector3<f64>>) -> Option<Vector3<f64>> {
    let there = values.filter(|v| !v.x.is_nan());
    let (sum, n) = there.fold((Vector3::zeros(), 0), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / f64::from(n))
}

fn mean_or_nan(values: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    mean(values).unwrap_or(Vector3::repeat(f64::NAN))
}

/// The log averaged down to about 100 Hz if it is faster than 120 Hz, without the columns that no diagnosis reads; the pistons keep their last
/// count.
pub fn thinned(log: &BendLog) -> Cow<'_, BendLog> {
    let rate = (log.t_s.len() - 1) as f64 / (log.t_s[log.t_s.len() - 1] - log.t_s[0]);
    let by = (rate / 100.0).round() as usize;
    if rate < 120.0 || by < 2 {
        return Cow::Borrowed(log);
    }
    let group = |g| (g * by, (g + 1) * by);
    let groups: Vec<(usize, usize)> = (0..log.t_s.len() / by).map(group).collect();
    let average = |v: &[Vector3<f64>]| {
        let of = |g: &(usize, usize)| mean_or_nan(v[g.0..g.1].iter().copied());
        groups.iter().map(of).collect::<Vec<_>>()
    };
    let middles = |r: &Vec<_>| groups.iter().map(|g| r[(g.0 + g.1) / 2]).collect();
    let imu = |i: &ImuColumns| ImuColumns {
        acc: average(&i.acc),
        gyr: average(&i.gyr),
        mag: average(&i.mag),
    };
    Cow::Owned(BendLog {
        t_s: groups.iter().map(|g| log.t_s[g.1 - 1]).collect(),
        piston_mm: groups.iter().map(|g| log.piston_mm[g.1 - 1]).collect(),
        imu: log.imu.as_ref().map(imu),
        base: log.base.as_ref().map(imu),
        reference: log.reference.as_ref().map(middles),
        file: log.file.clone(),
        ..BendLog::default()
    })
}

/// The bins of a long log that are compared with the model: a stretch of every few, so that the fits of an hour take no longer than those
/// of ten minutes. The model runs through the whole log.
pub fn compared(bins: Vec<Bin>) -> Vec<Bin> {
    let (Some(first), Some(last)) = (bins.first().copied(), bins.last()) else {
        return bins;
    };
    let every = ((last.t_s - first.t_s) / COMPARED_S).round() as usize;
    if every < 2 {
        return bins;
    }
    let kept = |b: &Bin| (((b.t_s - first.t_s) / STRETCH_S) as usize).is_multiple_of(every);
    let mut out: Vec<Bin> = bins.into_iter().filter(kept).collect();
    for k in 1..out.len() {
        if out[k].rows.0 > out[k - 1].rows.1 {
            // the mean rate since the bin before is not that since the one that is kept
            out[k].gyr = Vector3::repeat(f64::NAN);
        }
    }
    out
}

/// Bins of a log, without weights.
pub fn bins(log: &BendLog, rows: &[Row]) -> Vec<Bin> {
    let mut out: Vec<Bin> = Vec::new();
    let (mut from, mut middle) = (0, 0);
    while from < log.t_s.len() {
        let long = rows[from].idle_s > HOLD_AFTER_S && rows[from].t_s - rows[0].t_s > 1.0;
        let until = log.t_s[from] + if long { HOLD_BIN_S } else { BIN_S } - 1e-6;
        // a long bin ends where the motion begins
        let ends = |k: usize| log.t_s[k] >= until || (long && rows[k].idle_s == 0.0);
        let to = (from + 1..log.t_s.len()).find(|&k| ends(k));
        let to = to.unwrap_or(log.t_s.len());
        out.push(bin(log, rows, (from, to), middle));
        middle = (from + to) / 2;
        from = to;
    }
    out
}

/// One bin; its rate is averaged from row `since`, the middle of the bin before, to its own middle.
fn bin(log: &BendLog, rows: &[Row], (from, to): (usize, usize), since: usize) -> Bin {
    let nan = Vector3::repeat(f64::NAN);
    let of = |pick: fn(&ImuColumns) -> &Vec<Vector3<f64>>| {
        let mean = |i| mean_or_nan(pick(i)[from..to].iter().copied());
        log.imu.as_ref().map_or(nan, mean)
    };
    let tracked = log.reference.as_ref().map_or(&[][..], |r| &r[from..to]);
    let seen = tracked.iter().flatten();
    let seen: Vec<Matrix3<f64>> = seen.map(|q| q.to_rotation_matrix().into_inner()).collect();
    // of no orientations, the mean is not a number
    let reference = seen.iter().sum::<Matrix3<f64>>() / seen.len() as f64;
    let step_s = (log.t_s[to - 1] - log.t_s[from]) / (to - from).max(2).saturating_sub(1) as f64;
    let speed = |k: usize| {
        (rows[k].piston_mm - rows[k - 1].piston_mm).amax() / (rows[k].t_s - rows[k - 1].t_s)
    };
    // trapezoids: both ends at half weight
    let rate = |i: &ImuColumns| {
        let end = ((from + to) / 2).max(since + 1).min(log.t_s.len() - 1);
        mean_or_nan((since..end).map(|k| (i.gyr[k] + i.gyr[k + 1]) / 2.0))
    };
    Bin {
        rows: (from, to),
        t_s: (log.t_s[from] + log.t_s[to - 1]) / 2.0,
        lasting_s: match to - from {
            1 => BIN_S,
            rows => step_s * rows as f64,
        },
        reference,
        acc: of(|i| &i.acc),
        mag: of(|i| &i.mag),
        gyr: log.imu.as_ref().map_or(nan, rate),
        base: Matrix3::identity(),
        idle_s: rows[to - 1].idle_s,
        speed_mm_s: (from.max(1)..to).map(speed).fold(0.0, f64::max),
        ..Bin::default()
    }
}

/// White noise of a bin, degrees (°/s), from the median squared difference of neighbouring bins in still stretches.
/// The median ignores a tip that jumps or rings while the pistons are idle.
pub fn noise(bins: &[Bin], field_ut: f64) -> PerQuantity<f64> {
    let mut squares: PerQuantity<Vec<f64>> = PerQuantity::default();
    let still = |b: &Bin| b.idle_s > 0.3 && b.lasting_s < 1.5 * BIN_S;
    for w in bins.windows(2).filter(|w| still(&w[0]) && still(&w[1])) {
        let turn = between(&w[0].reference, &w[1].reference);
        let change = |of: fn(&Bin) -> Vector3<f64>| w[1].base * of(&w[1]) - w[0].base * of(&w[0]);
        let (acc, mag) = (change(|b| b.acc) / G_M_S2, change(|b| b.mag) / field_ut);
        let d = [turn, acc, mag, w[1].gyr - w[0].gyr];
        let pairs = Quantity::ALL.into_iter().zip(d);
        for (q, v) in pairs.filter(|(_, v)| !v.x.is_nan()) {
            squares[q].push(v.norm_squared());
        }
    }
    // the difference of two samples has twice the variance of one
    let sigma = |m: f64| (m / CHI2_3_MEDIAN / 2.0).sqrt().to_degrees();
    PerQuantity(squares.0.map(|s| median(s.into_iter()).map_or(0.0, sigma)))
}

/// Rotation vector of the small rotation from `a` to `b`, which may be means: half of the antisymmetric part of `aᵀ b`.
pub fn between(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Vector3<f64> {
    let dot = |i: usize, j: usize| a.column(i).dot(&b.column(j));
    let [x, y, z] = [(2, 1), (0, 2), (1, 0)].map(|(i, j)| dot(i, j) - dot(j, i));
    Vector3::new(x, y, z) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An hour is compared in stretches that lie in both folds of the scores; ten minutes are compared as a whole.
    #[test]
    fn a_part_of_a_long_log_is_compared() {
        let every = |until_s: f64| {
            let bin = |k: usize| Bin {
                t_s: k as f64 * 0.1,
                lasting_s: 0.1,
                rows: (10 * k, 10 * k + 10),
                ..Bin::default()
            };
            (0..(until_s * 10.0) as usize)
                .map(bin)
                .collect::<Vec<Bin>>()
        };
        assert_eq!(compared(every(600.0)).len(), 6000);
        let hour = compared(every(3600.0));
        let odd = hour
            .iter()
            .filter(|b| (b.t_s / 12.0) as usize % 2 == 1)
            .count();
        assert!(
            (5900..6300).contains(&hour.len()) && odd.abs_diff(hour.len() / 2) < 10,
            "{} {odd}",
            hour.len()
        );
        let gaps: Vec<&[Bin]> = hour
            .windows(2)
            .filter(|w| w[1].t_s - w[0].t_s > 1.0)
            .collect();
        assert!(
            gaps.len() > 20 && gaps.iter().all(|w| w[1].gyr.x.is_nan()),
            "{}",
            gaps.len()
        );
        assert_eq!(hour.iter().filter(|b| b.gyr.x.is_nan()).count(), gaps.len());
    }
}
