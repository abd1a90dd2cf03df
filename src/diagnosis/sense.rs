//! What the sensors make of a motion, and what that leaves of the log.
//!
//! Gravity and field in the base frame and the constant gyroscope bias are linear and solved inside
//! every evaluation (variable projection, Golub & Pereyra 1973) from the bins that `mask` lets in.

use crate::diagnosis::chain::{Model, Motion};
use crate::diagnosis::observe::{Bin, G_M_S2, Observed, back, between};
use crate::model::effects::{ImuPrediction, Memory, Moment, Stage};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// What the log says of itself once a model has been run.
#[derive(Debug, Clone, PartialEq)]
pub struct Scored {
    /// Residual vectors per bin and kind, rad (rad/s for the gyroscope), NaN-free, 0 where missing.
    pub residual: [Vec<Vector3<f64>>; 4],
    /// Gyroscope bias, gravity and field in the base frame, as solved.
    pub gyro_bias: Vector3<f64>,
    /// Gravity in the base frame, m/s².
    pub gravity: Vector3<f64>,
    /// Field in the base frame, µT.
    pub field: Vector3<f64>,
}

/// Changes of accelerometer, magnetometer and gyroscope in one bin.
type Changes = (Vector3<f64>, Vector3<f64>, Vector3<f64>);

/// Oldest that a rate may be without being called late, s.
const RATE_AGE_MAX_S: f64 = 0.006;

/// Predicts all kinds from a motion, solves the linear nominal parameters on `mask` (0 or 1 per bin).
#[must_use]
pub fn sense(log: &Observed, model: &Model<'_>, theta: &[f64], motion: &Motion, mask: &[f64]) -> Scored {
    let inertial = log.has[1] || log.has[2] || log.has[3];
    let imu = if inertial { Imu::new(log, model, theta, motion) } else { Imu::default() };
    let changed = if inertial { imu.changes(log, model, theta) } else { vec![] };
    let (gravity, field, bias) = solve(log, &imu, &changed, mask);
    let age_s = imu.rate_age_s(log, &changed, &bias, mask);
    let size = field.norm().max(1.0);
    let mut residual: [Vec<Vector3<f64>>; 4] = std::array::from_fn(|_| vec![Vector3::zeros(); log.bins.len()]);
    for (k, bin) in log.bins.iter().enumerate() {
        if bin.weight[0] > 0.0 {
            residual[0][k] = between(&motion[bin.at], &bin.reference);
        }
        if bin.weight[1] > 0.0 {
            residual[1][k] = (bin.acc - changed[k].0 - back(&imu.mean[k], &gravity)) / G_M_S2;
        }
        if bin.weight[2] > 0.0 {
            residual[2][k] = (bin.mag - changed[k].1 - back(&imu.mean[k], &field)) / size;
        }
        if bin.weight[3] > 0.0 {
            residual[3][k] = bin.gyr - changed[k].2 - imu.rate[k] - bias + imu.rate_slope(log, k) * age_s;
        }
    }
    Scored { residual, gyro_bias: bias, gravity, field }
}

/// Gravity (of known length), field and gyroscope bias that fit best.
fn solve(log: &Observed, imu: &Imu, changed: &[Changes], mask: &[f64]) -> Changes {
    let (mut g, mut m, mut b, mut w) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros(), [1e-12; 2]);
    for (k, bin) in log.bins.iter().enumerate().filter(|(k, _)| mask[*k] > 0.0) {
        let [_, wa, wm, wg] = bin.weight.map(|x| x * x);
        if wa > 0.0 {
            g += imu.mean[k] * (bin.acc - changed[k].0) * wa;
        }
        if wm > 0.0 {
            m += imu.mean[k] * (bin.mag - changed[k].1) * wm;
            w[0] += wm;
        }
        if wg > 0.0 {
            b += (bin.gyr - imu.rate[k] - changed[k].2) * wg;
            w[1] += wg;
        }
    }
    let gravity = if g.norm() > 0.0 { g.normalize() * G_M_S2 } else { log.up_base * G_M_S2 };
    (gravity, m / w[0], b / w[1])
}

/// Sensor in the base at rest, per bin.
#[derive(Default)]
struct Imu {
    mean: Vec<Matrix3<f64>>,
    rate: Vec<Vector3<f64>>,
}

impl Imu {
    fn new(log: &Observed, model: &Model<'_>, theta: &[f64], motion: &Motion) -> Self {
        let latency_s: f64 = model.each(theta).map(|(e, p)| e.latency_s(p)).sum();
        let mount = model.each(theta).filter_map(|(e, p)| e.mount(p)).fold(UnitQuaternion::identity(), |a, b| a * b);
        let mount: Option<Matrix3<f64>> = (mount.angle() > 0.0).then(|| mount.to_rotation_matrix().into_inner());
        let stands = !model.effects.iter().any(|e| e.stage() == Stage::Base);
        let mut late = Late { log, motion, behind_s: latency_s, at: 0 };
        let mut imu = Self { mean: Vec::with_capacity(log.bins.len()), rate: Vec::with_capacity(log.bins.len()) };
        let mut before: Option<(Matrix3<f64>, f64)> = None;
        for bin in &log.bins {
            let mut here = late.at(bin.at);
            if let Some(turn) = if stands { None } else { base_turn(log, model, theta, bin.t_s) } {
                here = turn * here;
            }
            if let Some(mount) = &mount {
                here *= mount;
            }
            let rate = before.map_or(Vector3::zeros(), |(r, t)| between(&r, &here) / (bin.t_s - t));
            imu.rate.push(rate);
            imu.mean.push(here);
            before = Some((here, bin.t_s));
        }
        imu
    }

    /// Slope of the rate at a bin, rad/s².
    fn rate_slope(&self, log: &Observed, k: usize) -> Vector3<f64> {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(self.rate.len() - 1));
        let span_s = log.bins[b].t_s - log.bins[a].t_s;
        if span_s > 0.3 { Vector3::zeros() } else { (self.rate[b] - self.rate[a]) / span_s }
    }

    /// By how much the gyroscope is late, within what sampling explains.
    fn rate_age_s(&self, log: &Observed, changed: &[Changes], bias: &Vector3<f64>, mask: &[f64]) -> f64 {
        let (mut up, mut down) = (0.0, 1e-12);
        for (k, bin) in log.bins.iter().enumerate().filter(|(k, b)| mask[*k] > 0.0 && b.weight[3] > 0.0) {
            let (slope, w) = (self.rate_slope(log, k), bin.weight[3].powi(2));
            up -= w * slope.dot(&(bin.gyr - changed[k].2 - self.rate[k] - bias));
            down += w * slope.norm_squared();
        }
        (up / down).clamp(-RATE_AGE_MAX_S, RATE_AGE_MAX_S)
    }

    /// What sensor effects add to acc, mag and gyro, averaged over each bin.
    fn changes(&self, log: &Observed, model: &Model<'_>, theta: &[f64]) -> Vec<Changes> {
        let mut out = vec![(Vector3::zeros(), Vector3::zeros(), Vector3::zeros()); log.bins.len()];
        for (e, p) in model.each(theta).filter(|(e, p)| e.sensing_only() && e.mount(p).is_none()) {
            let mut memory = Memory::default();
            for (k, bin) in log.bins.iter().enumerate() {
                let r = self.mean[k];
                let before = ImuPrediction {
                    acc_m_s2: back(&r, &log.up_base) * G_M_S2,
                    gyro_rad_s: self.rate[k],
                    mag_ut: back(&r, &log.field_base_ut),
                    r_base_sensor: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r)),
                };
                let rows = rows_of(log, bin, e.follows_motors());
                let n = rows.len() as f64;
                for row in rows {
                    let mut reading = before;
                    e.sensor(p, &mut memory, &moment(log, row, bin.t_s), &mut reading);
                    out[k].0 += (reading.acc_m_s2 - before.acc_m_s2) / n;
                    out[k].1 += (reading.mag_ut - before.mag_ut) / n;
                    out[k].2 += (reading.gyro_rad_s - before.gyro_rad_s) / n;
                }
            }
        }
        out
    }
}

/// Rows of a bin that a sensor effect has to be averaged over: the middle one, unless it follows the
/// motors and they move.
fn rows_of(log: &Observed, bin: &Bin, follows_motors: bool) -> std::ops::Range<usize> {
    let (from, to) = bin.rows;
    let moving = || log.rows.piston_mm[from] != log.rows.piston_mm[to - 1] || bin.idle_s < bin.lasting_s;
    if follows_motors && moving() {
        from..to
    } else {
        let middle = (from + to - 1) / 2;
        middle..middle + 1
    }
}

fn moment(log: &Observed, row: usize, t_s: f64) -> Moment {
    Moment {
        t_s: t_s - log.start_s(),
        dt_s: 0.01,
        counted_mm: log.rows.piston_mm[row],
        up_base: log.up_base,
        k_epsilon: Vector3::repeat(2.2),
        r_mm: 4.04,
        idle_s: log.rows.idle_s[row],
    }
}

fn base_turn(log: &Observed, model: &Model<'_>, theta: &[f64], t_s: f64) -> Option<Matrix3<f64>> {
    model.each(theta).find_map(|(e, p)| e.base(p, &moment(log, 0, t_s))).map(|q| q.to_rotation_matrix().into_inner())
}

/// Motion as the sensor samples it, some time ago.
struct Late<'a> {
    log: &'a Observed,
    motion: &'a Motion,
    behind_s: f64,
    at: usize,
}

impl Late<'_> {
    /// What is sampled at instant `k`; instants must be asked for in order.
    fn at(&mut self, k: usize) -> Matrix3<f64> {
        if self.behind_s <= 0.0 {
            return self.motion[k];
        }
        let (times, t) = (&self.log.t_s, self.log.t_s[k] - self.behind_s);
        while self.at + 1 < k && times[self.at + 1] <= t {
            self.at += 1;
        }
        let (a, b) = (self.at, (self.at + 1).min(times.len() - 1));
        let share = if b > a { ((t - times[a]) / (times[b] - times[a])).clamp(0.0, 1.0) } else { 0.0 };
        self.motion[a] * (1.0 - share) + self.motion[b] * share
    }
}
