//! Predicted readings of a motion, and the residuals they leave.
//!
//! Gravity and field in the base frame and the constant gyroscope bias enter linearly. Every evaluation solves them
//! (variable projection, Golub & Pereyra 1973) from the bins that a mask selects.

use crate::diagnosis::tip::model::{FIRST_STEP_S, Model, Motion, parameters, run};
use crate::diagnosis::tip::observed::{Bin, G_M_S2, Observed, PerQuantity, Quantity, Segment};
use crate::model::effects::{ImuPrediction, Memory, Moment, Stage};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Largest age of a gyroscope sample that counts as sampling, not as a late sensor, s.
const RATE_AGE_MAX_S: f64 = 0.006;
/// Longest span over which a slope of the rate is formed, s.
const SLOPE_SPAN_S: f64 = 0.3;

/// Residuals per quantity and bin, rad (gyroscope: rad/s); 0 where missing.
pub type Residuals = PerQuantity<Vec<Vector3<f64>>>;

/// The mask that selects every bin.
pub fn every_bin(_: usize) -> bool {
    true
}

/// Residuals of a motion; gravity, field and gyroscope bias of each log are solved on the bins that `mask` selects.
pub fn sense(
    log: &Observed,
    model: &Model<'_>,
    theta: &[f64],
    motion: &Motion,
    mask: impl Fn(usize) -> bool,
) -> Residuals {
    let mut residual = Residuals::from_fn(|_| vec![Vector3::zeros(); log.bins.len()]);
    for segment in &log.segments {
        let bins = &log.bins[segment.bins.clone()];
        let part = Part {
            log,
            segment,
            bins,
            model,
            theta: &parameters(log, segment, model, theta),
            motion,
        };
        part.sense(&|k| mask(segment.bins.start + k), &mut residual);
    }
    residual
}

/// Residuals of the motion with these parameters, with every bin selected.
pub fn residuals(log: &Observed, model: &Model<'_>, theta: &[f64]) -> Residuals {
    sense(log, model, theta, &run(log, model, theta), every_bin)
}

/// One log of those that are diagnosed together; its bins are counted from its first.
struct Part<'a> {
    log: &'a Observed,
    segment: &'a Segment,
    bins: &'a [Bin],
    model: &'a Model<'a>,
    theta: &'a [f64],
    motion: &'a Motion,
}

impl Part<'_> {
    fn sense(&self, mask: &impl Fn(usize) -> bool, residual: &mut Residuals) {
        let inertial = self.log.quantities().any(|q| q != Quantity::Reference);
        let imu = match inertial {
            true => Imu::new(self),
            false => Imu::default(),
        };
        let linear = imu.solve(self, mask);
        let age_s = imu.rate_age_s(self, &linear.gyr, mask);
        let field_ut = linear.mag.norm().max(1.0);
        for (k, bin) in self.bins.iter().enumerate() {
            for q in self.log.quantities().filter(|&q| bin.weight[q] > 0.0) {
                let (change, tip) = (&imu.change[k], &imu.tip[k]);
                residual[q][self.segment.bins.start + k] = match q {
                    Quantity::Reference => between(&self.motion[bin.at], &bin.reference),
                    Quantity::Acc => (bin.acc - change.acc - back(tip, &linear.acc)) / G_M_S2,
                    Quantity::Mag => (bin.mag - change.mag - back(tip, &linear.mag)) / field_ut,
                    Quantity::Gyro => {
                        let slope = imu.rate_slope(self, k);
                        bin.gyr - change.gyr - imu.rate[k] - linear.gyr + slope * age_s
                    }
                };
            }
        }
    }

    fn moment(&self, row: usize, t_s: f64) -> Moment {
        let Observed { rig, rows, .. } = self.log;
        Moment {
            t_s: t_s - self.segment.start_s,
            dt_s: FIRST_STEP_S,
            counted_mm: rows.piston_mm[row],
            up_base: self.segment.up_base,
            k_epsilon: Vector3::repeat(rig.prior.k_epsilon),
            r_mm: rig.geometry.r_mm,
            idle_s: rows.idle_s[row],
        }
    }

    fn base_turn(&self, t_s: f64) -> Option<Matrix3<f64>> {
        let at = self.moment(self.segment.rows.start, t_s);
        let turn = self
            .model
            .each(self.theta)
            .find_map(|(e, p)| e.base(p, &at));
        turn.map(|q| q.to_rotation_matrix().into_inner())
    }
}

/// One value per inertial sensor: m/s², µT, rad/s.
#[derive(Clone, Copy, Default)]
struct Readings {
    acc: Vector3<f64>,
    mag: Vector3<f64>,
    gyr: Vector3<f64>,
}

/// Prediction of the IMU, bin by bin.
#[derive(Default)]
struct Imu {
    /// Sensor in the base frame.
    tip: Vec<Matrix3<f64>>,
    /// Mean rate since the bin before, rad/s.
    rate: Vec<Vector3<f64>>,
    /// What sensor effects add to the readings, averaged over the bin.
    change: Vec<Readings>,
}

impl Imu {
    fn new(part: &Part<'_>) -> Self {
        let (model, theta, bins) = (part.model, part.theta, part.bins);
        let behind_s: f64 = model.each(theta).map(|(e, p)| e.latency_s(p)).sum();
        let mounts = model.each(theta).filter_map(|(e, p)| e.mount(p));
        let mount = mounts.fold(UnitQuaternion::identity(), |a, b| a * b);
        let mount: Option<Matrix3<f64>> =
            (mount.angle() > 0.0).then(|| mount.to_rotation_matrix().into_inner());
        let base_moves = model.effects.iter().any(|e| e.stage() == Stage::Base);
        let mut late = Late {
            log: part.log,
            motion: part.motion,
            behind_s,
            at: part.segment.instants.start,
        };
        let mut imu = Self {
            tip: Vec::with_capacity(bins.len()),
            rate: Vec::with_capacity(bins.len()),
            change: vec![],
        };
        let mut before: Option<(Matrix3<f64>, f64)> = None;
        for bin in bins {
            let mut here = bin.base * late.at(bin.at);
            if let Some(turn) = base_moves.then(|| part.base_turn(bin.t_s)).flatten() {
                here = turn * here;
            }
            if let Some(mount) = &mount {
                here *= mount;
            }
            let rate = |(r, t): (Matrix3<f64>, f64)| between(&r, &here) / (bin.t_s - t);
            imu.rate.push(before.map_or(Vector3::zeros(), rate));
            imu.tip.push(here);
            before = Some((here, bin.t_s));
        }
        imu.change = imu.changes(part);
        imu
    }

    /// Gravity (of known length), field and gyroscope bias that fit best.
    fn solve(&self, part: &Part<'_>, mask: &impl Fn(usize) -> bool) -> Readings {
        let (mut sum, mut weight) = (Readings::default(), [1e-12; 2]);
        for (k, bin) in part.bins.iter().enumerate().filter(|(k, _)| mask(*k)) {
            let [_, acc, mag, gyr] = bin.weight.0.map(|x| x * x);
            if acc > 0.0 {
                sum.acc += self.tip[k] * (bin.acc - self.change[k].acc) * acc;
            }
            if mag > 0.0 {
                sum.mag += self.tip[k] * (bin.mag - self.change[k].mag) * mag;
                weight[0] += mag;
            }
            if gyr > 0.0 {
                sum.gyr += (bin.gyr - self.rate[k] - self.change[k].gyr) * gyr;
                weight[1] += gyr;
            }
        }
        let up = match sum.acc.norm() > 0.0 {
            true => sum.acc.normalize(),
            false => part.segment.up_base,
        };
        Readings {
            acc: up * G_M_S2,
            mag: sum.mag / weight[0],
            gyr: sum.gyr / weight[1],
        }
    }

    /// Slope of the rate at a bin, rad/s².
    fn rate_slope(&self, part: &Part<'_>, k: usize) -> Vector3<f64> {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(self.rate.len() - 1));
        let span_s = part.bins[b].t_s - part.bins[a].t_s;
        match span_s > SLOPE_SPAN_S {
            true => Vector3::zeros(),
            false => (self.rate[b] - self.rate[a]) / span_s,
        }
    }

    /// Age of the gyroscope samples, s, within what sampling explains.
    fn rate_age_s(
        &self,
        part: &Part<'_>,
        bias: &Vector3<f64>,
        mask: &impl Fn(usize) -> bool,
    ) -> f64 {
        let (mut up, mut down) = (0.0, 1e-12);
        let used = |(k, b): &(usize, &Bin)| mask(*k) && b.weight[Quantity::Gyro] > 0.0;
        for (k, bin) in part.bins.iter().enumerate().filter(used) {
            let (slope, w) = (self.rate_slope(part, k), bin.weight[Quantity::Gyro].powi(2));
            up -= w * slope.dot(&(bin.gyr - self.change[k].gyr - self.rate[k] - bias));
            down += w * slope.norm_squared();
        }
        (up / down).clamp(-RATE_AGE_MAX_S, RATE_AGE_MAX_S)
    }

    fn changes(&self, part: &Part<'_>) -> Vec<Readings> {
        let (segment, bins) = (part.segment, part.bins);
        let mut out = vec![Readings::default(); bins.len()];
        let sensing = part.model.each(part.theta);
        for (e, p) in sensing.filter(|(e, p)| e.sensing_only() && e.mount(p).is_none()) {
            let mut memory = Memory::default();
            for (k, bin) in bins.iter().enumerate() {
                let r = self.tip[k];
                let turned = Rotation3::from_matrix_unchecked(r);
                let before = ImuPrediction {
                    acc_m_s2: back(&r, &segment.up_base) * G_M_S2,
                    gyro_rad_s: self.rate[k],
                    mag_ut: back(&r, &segment.field_base_ut),
                    r_base_sensor: UnitQuaternion::from_rotation_matrix(&turned),
                };
                let rows = rows_of(part.log, bin, e.follows_motors());
                let n = rows.len() as f64;
                for row in rows {
                    let mut reading = before;
                    e.sensor(p, &mut memory, &part.moment(row, bin.t_s), &mut reading);
                    out[k].acc += (reading.acc_m_s2 - before.acc_m_s2) / n;
                    out[k].mag += (reading.mag_ut - before.mag_ut) / n;
                    out[k].gyr += (reading.gyro_rad_s - before.gyro_rad_s) / n;
                }
            }
        }
        out
    }
}

/// Rows over which a sensor effect is averaged: the middle row, or all rows if the effect follows moving motors.
fn rows_of(log: &Observed, bin: &Bin, follows_motors: bool) -> std::ops::Range<usize> {
    let (from, to) = bin.rows;
    let moving =
        || log.rows.piston_mm[from] != log.rows.piston_mm[to - 1] || bin.idle_s < bin.lasting_s;
    let middle = (from + to - 1) / 2;
    match follows_motors && moving() {
        true => from..to,
        false => middle..middle + 1,
    }
}

/// Motion as a late sensor samples it.
struct Late<'a> {
    log: &'a Observed,
    motion: &'a Motion,
    behind_s: f64,
    at: usize,
}

impl Late<'_> {
    /// Orientation sampled at instant `k`; `k` must not decrease from call to call.
    fn at(&mut self, k: usize) -> Matrix3<f64> {
        if self.behind_s <= 0.0 {
            return self.motion[k];
        }
        let (times, t) = (&self.log.t_s, self.log.t_s[k] - self.behind_s);
        while self.at + 1 < k && times[self.at + 1] <= t {
            self.at += 1;
        }
        let (a, b) = (self.at, (self.at + 1).min(times.len() - 1));
        let share = match b > a {
            true => ((t - times[a]) / (times[b] - times[a])).clamp(0.0, 1.0),
            false => 0.0,
        };
        self.motion[a] * (1.0 - share) + self.motion[b] * share
    }
}

/// Rotation vector of the small rotation from `a` to `b`: half of the antisymmetric part of `aᵀ b`.
pub fn between(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Vector3<f64> {
    let (a, b) = (a.as_slice(), b.as_slice());
    let dot = |i: usize, j: usize| {
        a[3 * i] * b[3 * j] + a[3 * i + 1] * b[3 * j + 1] + a[3 * i + 2] * b[3 * j + 2]
    };
    Vector3::new(
        dot(2, 1) - dot(1, 2),
        dot(0, 2) - dot(2, 0),
        dot(1, 0) - dot(0, 1),
    ) / 2.0
}

/// `aᵀ v`.
fn back(a: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let a = a.as_slice();
    Vector3::new(
        a[0] * v.x + a[1] * v.y + a[2] * v.z,
        a[3] * v.x + a[4] * v.y + a[5] * v.z,
        a[6] * v.x + a[7] * v.y + a[8] * v.z,
    )
}
