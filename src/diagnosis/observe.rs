//! What a log says, in bins of 50 ms (200 ms in long holds) with weights in degrees.
//!
//! A reading averaged over a bin is what the middle of the bin predicts, up to the curvature of the
//! motion within it, so the model is compared at the middles only. It is run row by row while a piston
//! moves and in the steps of the bins while none does. Four kinds of observation stand beside
//! each other and are never fused: tracker, accelerometer, magnetometer (each as an angle) and
//! gyroscope (as a rate). A fault of one sensor then shows in one kind, a mechanical one in all.

use crate::log::bend_log::{BendLog, ImuColumns};
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

/// Length of a bin, s.
pub const BIN_S: f64 = 0.05;
/// Length of a bin in a long hold, s, and how long the pistons must have been idle for it.
const HOLD_BIN_S: f64 = 0.2;
const HOLD_AFTER_S: f64 = 1.5;
/// Gravity, m/s².
pub const G_M_S2: f64 = 9.80665;
/// Shortest log that is diagnosed, s.
const LENGTH_MIN_S: f64 = 20.0;
/// Piston path below which a log counts as motionless, mm.
const PATH_MIN_MM: f64 = 20.0;

/// Kinds of observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Tracker reference.
    Reference,
    /// Accelerometer as a direction.
    Acc,
    /// Magnetometer as a direction.
    Mag,
    /// Gyroscope.
    Gyro,
}

impl Quantity {
    /// All, in the order of residual blocks.
    pub const ALL: [Self; 4] = [Self::Reference, Self::Acc, Self::Mag, Self::Gyro];

    /// Name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Acc => "accelerometer",
            Self::Mag => "magnetometer",
            Self::Gyro => "gyroscope",
        }
    }
}

/// Why a log cannot be diagnosed.
#[derive(Debug, Error, PartialEq)]
pub enum Unfit {
    /// Too short.
    #[error(
        "the log is {0:.1} s long; a diagnosis needs at least 20 s, and about 250 s with holds and several speeds: record the schedule of `retroflex gap excite`"
    )]
    Short(f64),
    /// Nothing moves.
    #[error(
        "the pistons travel {0:.1} mm in the whole log; nothing can be told from a tip that does not move: record the schedule of `retroflex gap excite`"
    )]
    Motionless(f64),
    /// Nothing is sensed.
    #[error("the log has neither a tip IMU (acc_*, gyr_*) nor a reference (ref_q*) with values in it: record at least one of them")]
    Blind,
    /// No rest at the start.
    #[error(
        "the pistons move within the first {0:.1} s; the rest at the start defines zero bend and the base frame: record at least 2 s of rest first"
    )]
    NoRest(f64),
    /// A sensor at its stop.
    #[error(
        "{0} stands at one value, {1}, for {2:.0} % of the moving time: it is clipped or frozen; choose a larger range, or check the sensor, and record again"
    )]
    Clipped(&'static str, f64, f64),
}

/// One bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// First row and one past the last.
    pub rows: (usize, usize),
    /// Index of its middle among the instants.
    pub at: usize,
    /// Middle, s.
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
    /// 1/σ of each kind of residual (per rad, per rad, per rad, per rad/s); 0 where missing.
    pub weight: [f64; 4],
    /// Seconds since a piston last moved.
    pub idle_s: f64,
    /// Fastest piston, mm/s.
    pub speed_mm_s: f64,
}

/// Pistons row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows {
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Counted pistons, mm.
    pub piston_mm: Vec<Vector3<f64>>,
    /// Seconds since a piston last moved.
    pub idle_s: Vec<f64>,
}

impl Rows {
    fn new(log: &BendLog) -> Self {
        let mut idle_s = vec![10.0];
        for k in 1..log.t_s.len() {
            let moved = log.piston_mm[k] != log.piston_mm[k - 1];
            idle_s.push(if moved { 0.0 } else { idle_s[k - 1] + log.t_s[k] - log.t_s[k - 1] });
        }
        Self { t_s: log.t_s.clone(), piston_mm: log.piston_mm.clone(), idle_s }
    }

    /// Counted pistons at time `t_s`, by a straight line between rows `k` and `k + 1`.
    #[must_use]
    pub fn piston_after(&self, k: usize, t_s: f64) -> Vector3<f64> {
        let Some(next) = self.t_s.get(k + 1) else { return self.piston_mm[k] };
        let share = ((t_s - self.t_s[k]) / (next - self.t_s[k])).clamp(0.0, 1.0);
        self.piston_mm[k].lerp(&self.piston_mm[k + 1], share)
    }
}

/// A log ready to be fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Observed {
    /// Instants the model is run at, s.
    pub t_s: Vec<f64>,
    /// Counted pistons at them, mm.
    pub piston_mm: Vec<Vector3<f64>>,
    /// Seconds since a piston last moved, at them.
    pub idle_s: Vec<f64>,
    /// Whether an instant is the middle of a bin.
    pub middle: Vec<bool>,
    /// The log's own rows, for what depends on every single step.
    pub rows: Rows,
    /// Bins.
    pub bins: Vec<Bin>,
    /// Which kinds are there.
    pub has: [bool; 4],
    /// Mean specific force at the initial rest over its norm: up, in the base frame.
    pub up_base: Vector3<f64>,
    /// Mean field at rest, µT.
    pub field_base_ut: Vector3<f64>,
    /// White noise of one bin, degrees (°/s for the gyroscope), from still stretches.
    pub noise_deg: [f64; 4],
}

/// Model error that a nominal unit is allowed per angle, rad (1 σ): what is not worth a name.
const ANGLE_FLOOR_RAD: f64 = 0.0044;
/// The same for rates, rad/s.
const RATE_FLOOR_RAD_S: f64 = 0.007;
/// Part of the turning rate that a rate prediction may miss by.
const RATE_SHARE: f64 = 0.12;
/// Error of gravity as a direction while the tip turns, rad per rad/s.
const ACC_MOTION: f64 = 0.012;
/// Error of any angle while the tip turns (timing within a bin), rad per rad/s.
const ANGLE_MOTION: f64 = 0.006;

impl Observed {
    /// Bins a log; refuses one that cannot be diagnosed.
    ///
    /// # Errors
    /// [`Unfit`].
    pub fn new(log: &BendLog) -> Result<Self, Unfit> {
        refuse(log)?;
        let log = &thinned(log);
        let rows = Rows::new(log);
        let bins = bins(log, &rows);
        let mut o = Self {
            t_s: vec![],
            piston_mm: vec![],
            idle_s: vec![],
            middle: vec![],
            rows,
            bins,
            has: [false; 4],
            up_base: Vector3::z(),
            field_base_ut: Vector3::zeros(),
            noise_deg: [0.0; 4],
        };
        o.place_instants();
        let rest = o.rest_bins();
        o.up_base = mean(o.bins[..rest].iter().map(|b| b.acc)).map_or(Vector3::z(), |v| v.normalize());
        o.field_base_ut = mean(o.bins[..rest].iter().map(|b| b.mag)).unwrap_or_default();
        let field = o.field_base_ut.norm().max(1.0);
        o.noise_deg = noise(&o.bins, field);
        o.weigh();
        if !o.has.iter().any(|&h| h) {
            return Err(Unfit::Blind);
        }
        Ok(o)
    }

    /// Bins before the first motion.
    fn rest_bins(&self) -> usize {
        self.bins.iter().position(|b| b.speed_mm_s > 0.0).unwrap_or(self.bins.len()).max(1)
    }

    /// Middles of bins and, while a piston moves, every row between them: what comes after a corner
    /// depends on where the corner is.
    fn place_instants(&mut self) {
        let mut before = 0;
        for k in 0..self.bins.len() {
            let bin = self.bins[k];
            let row = (bin.rows.0 + bin.rows.1 - 1) / 2;
            if self.rows.idle_s[row] < self.rows.t_s[row] - self.rows.t_s[before] {
                for between in before + 1..row {
                    self.push_instant(self.rows.t_s[between], self.rows.piston_mm[between], between, false);
                }
            }
            self.bins[k].at = self.t_s.len();
            self.push_instant(bin.t_s, self.rows.piston_after(row, bin.t_s), row, true);
            before = row;
        }
    }

    fn push_instant(&mut self, t_s: f64, piston_mm: Vector3<f64>, row: usize, middle: bool) {
        self.middle.push(middle);
        self.t_s.push(t_s);
        self.piston_mm.push(piston_mm);
        self.idle_s.push(self.rows.idle_s[row]);
    }

    fn weigh(&mut self) {
        for b in &mut self.bins {
            let turning = if b.gyr.x.is_nan() { 0.1 * b.speed_mm_s } else { b.gyr.norm() };
            let angle = |white_deg: f64, motion: f64| {
                let motion = motion * turning;
                1.0 / (white_deg.to_radians().powi(2) + ANGLE_FLOOR_RAD.powi(2) + motion * motion).sqrt()
            };
            let rate = (self.noise_deg[3].to_radians().powi(2) + RATE_FLOOR_RAD_S.powi(2) + (RATE_SHARE * turning).powi(2)).sqrt();
            let present = [b.reference[(0, 0)], b.acc.x, b.mag.x, b.gyr.x].map(|x| !x.is_nan());
            let weight = [
                angle(self.noise_deg[0], ANGLE_MOTION),
                angle(self.noise_deg[1], ACC_MOTION),
                angle(self.noise_deg[2], ANGLE_MOTION),
                1.0 / rate,
            ];
            let long = (b.lasting_s / BIN_S).sqrt();
            for k in 0..4 {
                b.weight[k] = if present[k] { weight[k] * long } else { 0.0 };
                self.has[k] |= present[k];
            }
        }
    }

    /// Length of the log, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.rows.t_s.last().copied().unwrap_or(0.0) - self.start_s()
    }

    /// Time of the first row, s.
    #[must_use]
    pub fn start_s(&self) -> f64 {
        self.rows.t_s.first().copied().unwrap_or(0.0)
    }
}

fn mean(values: impl Iterator<Item = Vector3<f64>>) -> Option<Vector3<f64>> {
    let (sum, n) = values.filter(|v| !v.x.is_nan()).fold((Vector3::zeros(), 0), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / f64::from(n))
}

fn refuse(log: &BendLog) -> Result<(), Unfit> {
    let duration = log.t_s.last().copied().unwrap_or(0.0) - log.t_s.first().copied().unwrap_or(0.0);
    if duration < LENGTH_MIN_S {
        return Err(Unfit::Short(duration));
    }
    let path: f64 = log.piston_mm.windows(2).map(|w| (w[1] - w[0]).abs().sum()).sum();
    if path < PATH_MIN_MM {
        return Err(Unfit::Motionless(path));
    }
    let moves = log.piston_mm.iter().position(|p| (p - log.piston_mm[0]).amax() > 1e-9).unwrap_or(0);
    let rest_s = log.t_s[moves] - log.t_s[0];
    if rest_s < 1.0 {
        return Err(Unfit::NoRest(rest_s));
    }
    if let Some(imu) = &log.imu {
        clipped("acc_*_m_s2", &imu.acc, log)?;
        clipped("gyr_*_rad_s", &imu.gyr, log)?;
    }
    Ok(())
}

/// A channel at exactly one extreme value for a good part of the moving time stands at its stop.
fn clipped(name: &'static str, values: &[Vector3<f64>], log: &BendLog) -> Result<(), Unfit> {
    let moving: Vec<usize> = (1..log.piston_mm.len()).filter(|&k| log.piston_mm[k] != log.piston_mm[k - 1]).collect();
    for axis in 0..3 {
        let column = || moving.iter().filter_map(|&k| values.get(k)).map(|v| v[axis]).filter(|v| !v.is_nan());
        let n = column().count();
        for extreme in [column().fold(f64::NEG_INFINITY, f64::max), column().fold(f64::INFINITY, f64::min)] {
            let share = column().filter(|&v| v == extreme).count() as f64 / n.max(1) as f64;
            if n > 200 && share > 0.05 {
                return Err(Unfit::Clipped(name, extreme, share * 100.0));
            }
        }
    }
    Ok(())
}

/// A log faster than 120 Hz is averaged down to about 100 Hz; the pistons keep their last count.
fn thinned(log: &BendLog) -> BendLog {
    let rate = (log.t_s.len() - 1) as f64 / (log.t_s[log.t_s.len() - 1] - log.t_s[0]);
    let by = (rate / 100.0).round() as usize;
    if rate < 120.0 || by < 2 {
        return log.clone();
    }
    let groups: Vec<(usize, usize)> = (0..log.t_s.len() / by).map(|g| (g * by, (g + 1) * by)).collect();
    let last = |v: &[Vector3<f64>]| groups.iter().map(|g| v[g.1 - 1]).collect::<Vec<_>>();
    let average = |v: &[Vector3<f64>]| {
        groups.iter().map(|g| mean(v[g.0..g.1].iter().copied()).unwrap_or(Vector3::repeat(f64::NAN))).collect::<Vec<_>>()
    };
    let imu = |i: &ImuColumns| ImuColumns { acc: average(&i.acc), gyr: average(&i.gyr), mag: average(&i.mag) };
    BendLog {
        t_s: groups.iter().map(|g| log.t_s[g.1 - 1]).collect(),
        command: last(&log.command),
        piston_mm: last(&log.piston_mm),
        imu: log.imu.as_ref().map(imu),
        base: log.base.as_ref().map(imu),
        reference: log.reference.as_ref().map(|r| groups.iter().map(|g| r[(g.0 + g.1) / 2]).collect()),
        pressure_kpa: log.pressure_kpa.as_ref().map(|p| average(p)),
        temp_c: log.temp_c.as_ref().map(|t| groups.iter().map(|g| t[g.1 - 1]).collect()),
        file: log.file.clone(),
        ignored: log.ignored.clone(),
    }
}

fn bins(log: &BendLog, rows: &Rows) -> Vec<Bin> {
    let mut out: Vec<Bin> = Vec::new();
    let (mut from, mut middle) = (0, 0);
    while from < log.t_s.len() {
        let long = rows.idle_s[from] > HOLD_AFTER_S && rows.t_s[from] - rows.t_s[0] > 1.0;
        let until = log.t_s[from] + if long { HOLD_BIN_S } else { BIN_S } - 1e-6;
        // a long bin ends where the motion begins
        let ends = |k: usize| log.t_s[k] >= until || (long && rows.idle_s[k] == 0.0);
        let to = (from + 1..log.t_s.len()).find(|&k| ends(k)).unwrap_or(log.t_s.len());
        out.push(bin(log, rows, (from, to), middle));
        middle = (from + to) / 2;
        from = to;
    }
    out
}

/// Rates are averaged from the middle of the bin before, `since`, to this one's.
fn bin(log: &BendLog, rows: &Rows, (from, to): (usize, usize), since: usize) -> Bin {
    let nan = Vector3::repeat(f64::NAN);
    let of = |pick: fn(&ImuColumns) -> &Vec<Vector3<f64>>, from: usize, to: usize| {
        log.imu.as_ref().and_then(|i| mean(pick(i)[from..to].iter().copied())).unwrap_or(nan)
    };
    let reference = log.reference.as_ref().map_or(Matrix3::repeat(f64::NAN), |r| {
        let seen: Vec<_> = r[from..to].iter().flatten().collect();
        let sum = seen.iter().fold(Matrix3::zeros(), |s, q| s + q.to_rotation_matrix().into_inner());
        if seen.is_empty() { Matrix3::repeat(f64::NAN) } else { sum / seen.len() as f64 }
    });
    let step_s = (log.t_s[to - 1] - log.t_s[from]) / (to - from).max(2).saturating_sub(1) as f64;
    let speed = |k: usize| (rows.piston_mm[k] - rows.piston_mm[k - 1]).amax() / (rows.t_s[k] - rows.t_s[k - 1]);
    Bin {
        rows: (from, to),
        at: 0,
        t_s: (log.t_s[from] + log.t_s[to - 1]) / 2.0,
        lasting_s: if to - from > 1 { step_s * (to - from) as f64 } else { BIN_S },
        reference,
        acc: of(|i| &i.acc, from, to),
        mag: of(|i| &i.mag, from, to),
        gyr: log.imu.as_ref().map_or(nan, |i| trapezoid(&i.gyr, since, ((from + to) / 2).max(since + 1).min(log.t_s.len() - 1))),
        weight: [0.0; 4],
        idle_s: rows.idle_s[to - 1],
        speed_mm_s: (from.max(1)..to).map(speed).fold(0.0, f64::max),
    }
}

/// Mean from sample `from` to sample `to`, both at half weight; NaN if no pair of neighbours is there.
fn trapezoid(v: &[Vector3<f64>], from: usize, to: usize) -> Vector3<f64> {
    mean((from..to).map(|k| (v[k] + v[k + 1]) / 2.0)).unwrap_or(Vector3::repeat(f64::NAN))
}

/// Median of a chi-squared variable of three degrees of freedom.
const CHI2_3_MEDIAN: f64 = 2.366;

/// White noise of a bin from differences of neighbouring bins in still stretches, degrees (°/s); their
/// median, because a tip that jumps or rings while the pistons rest makes no noise of the sensors.
fn noise(bins: &[Bin], field_ut: f64) -> [f64; 4] {
    let mut squares: [Vec<f64>; 4] = Default::default();
    let quiet = |b: &Bin| b.idle_s > 0.3 && b.lasting_s < 1.5 * BIN_S;
    for w in bins.windows(2).filter(|w| quiet(&w[0]) && quiet(&w[1])) {
        let turn = vee(&(w[0].reference.transpose() * w[1].reference));
        let d = [turn, (w[1].acc - w[0].acc) / G_M_S2, (w[1].mag - w[0].mag) / field_ut, w[1].gyr - w[0].gyr];
        for (s, v) in squares.iter_mut().zip(d).filter(|(_, v)| !v.x.is_nan()) {
            s.push(v.norm_squared());
        }
    }
    squares.map(|mut s| {
        s.sort_by(f64::total_cmp);
        // median of a chi-squared of three; a difference of two has twice the variance
        s.get(s.len() / 2).map_or(0.0, |m| (m / CHI2_3_MEDIAN / 2.0).sqrt().to_degrees())
    })
}

/// Rotation vector of a small rotation given as a (mean) matrix: ½ of its antisymmetric part.
#[must_use]
#[inline]
pub fn vee(a: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(a[(2, 1)] - a[(1, 2)], a[(0, 2)] - a[(2, 0)], a[(1, 0)] - a[(0, 1)]) / 2.0
}

/// `vee(aᵀ b)`: the small rotation from `a` to `b`.
#[must_use]
#[inline]
pub fn between(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Vector3<f64> {
    let (a, b) = (a.as_slice(), b.as_slice());
    let dot = |i: usize, j: usize| a[3 * i] * b[3 * j] + a[3 * i + 1] * b[3 * j + 1] + a[3 * i + 2] * b[3 * j + 2];
    Vector3::new(dot(2, 1) - dot(1, 2), dot(0, 2) - dot(2, 0), dot(1, 0) - dot(0, 1)) / 2.0
}

/// `aᵀ v`.
#[must_use]
#[inline]
pub fn back(a: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let a = a.as_slice();
    Vector3::new(a[0] * v.x + a[1] * v.y + a[2] * v.z, a[3] * v.x + a[4] * v.y + a[5] * v.z, a[6] * v.x + a[7] * v.y + a[8] * v.z)
}
