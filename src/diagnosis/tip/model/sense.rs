//! Predicted readings of a motion, and the residuals they leave.
//!
//! Gravity and field in the base frame and the constant gyroscope bias enter linearly. Every evaluation solves them
//! (variable projection, Golub & Pereyra 1973) from the bins that a mask selects.

use crate::diagnosis::tip::model::{FIRST_STEP_S, Motion, parameters, run};
use crate::diagnosis::tip::observed::{
    Bin, G_M_S2, Observed, PerQuantity, Quantity, Segment, between,
};
use crate::model::Model;
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
    model: &Model,
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
            mask: &|k| mask(segment.bins.start + k),
        };
        part.sense(&mut residual);
    }
    residual
}

/// Residuals of the motion with these parameters, with every bin selected.
pub fn residuals(log: &Observed, model: &Model, theta: &[f64]) -> Residuals {
    sense(log, model, theta, &run(log, model, theta), every_bin)
}

/// One log of those that are diagnosed together; its bins are counted from its first.
struct Part<'a> {
    log: &'a Observed,
    segment: &'a Segment,
    bins: &'a [Bin],
    model: &'a Model,
    theta: &'a [f64],
    motion: &'a Motion,
    mask: &'a dyn Fn(usize) -> bool,
}

impl Part<'_> {
    fn sense(&self, residual: &mut Residuals) {
        let imu = Imu::new(self);
        let linear = imu.solve(self);
        let age_s = imu.rate_age_s(self, &linear.gyr);
        let field_ut = linear.mag.norm().max(1.0);
        for (k, bin) in self.bins.iter().enumerate() {
            for q in self.log.quantities().filter(|&q| bin.weight[q] > 0.0) {
                let (change, tip) = (&imu.change[k], &imu.tip[k]);
                residual[q][self.segment.bins.start + k] = match q {
                    Quantity::Reference => between(&self.motion[bin.at], &bin.reference),
                    Quantity::Acc => (bin.acc - change.acc - tip.tr_mul(&linear.acc)) / G_M_S2,
                    Quantity::Mag => (bin.mag - change.mag - tip.tr_mul(&linear.mag)) / field_ut,
                    Quantity::Gyro => {
                        let slope = imu.rate_slope(self, k);
                        bin.gyr - change.gyr - imu.rate[k] - linear.gyr + slope * age_s
                    }
                };
            }
        }
    }

    /// The bins that the mask selects.
    fn selected(&self) -> impl Iterator<Item = (usize, &Bin)> {
        let bins = self.bins.iter().enumerate();
        bins.filter(|(k, _)| (self.mask)(*k))
    }

    fn moment(&self, row: usize, t_s: f64) -> Moment {
        let Observed { rig, rows, .. } = self.log;
        Moment {
            t_s: t_s - self.segment.start_s,
            dt_s: FIRST_STEP_S,
            counted_mm: rows[row].piston_mm,
            up_base: self.segment.rest.up,
            k_epsilon: Vector3::repeat(rig.prior.k_epsilon),
            r_mm: rig.geometry.r_mm,
            idle_s: rows[row].idle_s,
        }
    }

    fn base_turn(&self, t_s: f64) -> Option<Matrix3<f64>> {
        let at = self.moment(self.segment.rows.start, t_s);
        let mut turns = self.model.each(self.theta);
        turns.find_map(|(e, p)| e.base(p, &at)).map(matrix)
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
        let mount = Some(mount).filter(|m| m.angle() > 0.0).map(matrix);
        let base_moves = model.effects.iter().any(|e| e.stage() == Stage::Base);
        // the motion as a late sensor samples it; called with increasing instants
        let (motion, instants) = (part.motion, &part.log.instants);
        let mut a = part.segment.instants.start;
        let mut sampled = |k: usize| {
            if behind_s <= 0.0 {
                return motion[k];
            }
            let t = instants[k].t_s - behind_s;
            while a + 1 < k && instants[a + 1].t_s <= t {
                a += 1;
            }
            let b = (a + 1).min(instants.len() - 1);
            let share = if b > a {
                let (from, to) = (instants[a].t_s, instants[b].t_s);
                ((t - from) / (to - from)).clamp(0.0, 1.0)
            } else {
                0.0
            };
            motion[a] * (1.0 - share) + motion[b] * share
        };
        let mut imu = Self::default();
        let mut before: Option<(Matrix3<f64>, f64)> = None;
        for bin in bins {
            let mut here = bin.base * sampled(bin.at);
            if base_moves {
                here = part.base_turn(bin.t_s).map_or(here, |turn| turn * here);
            }
            here = mount.map_or(here, |mount| here * mount);
            let rate = |(r, t): (Matrix3<f64>, f64)| between(&r, &here) / (bin.t_s - t);
            imu.rate.push(before.map_or(Vector3::zeros(), rate));
            imu.tip.push(here);
            before = Some((here, bin.t_s));
        }
        imu.change = imu.changes(part);
        imu
    }

    /// Gravity (of known length), field and gyroscope bias that fit best.
    fn solve(&self, part: &Part<'_>) -> Readings {
        let (mut sum, mut weight) = (Readings::default(), [1e-12; 2]);
        for (k, bin) in part.selected() {
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
        let up = sum.acc.try_normalize(0.0);
        let up = up.unwrap_or(part.segment.rest.up);
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
        let slope = (span_s <= SLOPE_SPAN_S).then(|| (self.rate[b] - self.rate[a]) / span_s);
        slope.unwrap_or_default()
    }

    /// Age of the gyroscope samples, s, within what sampling explains.
    fn rate_age_s(&self, part: &Part<'_>, bias: &Vector3<f64>) -> f64 {
        let (mut up, mut down) = (0.0, 1e-12);
        let rates = part
            .selected()
            .filter(|(_, b)| b.weight[Quantity::Gyro] > 0.0);
        for (k, bin) in rates {
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
                    acc_m_s2: r.tr_mul(&segment.rest.up) * G_M_S2,
                    gyro_rad_s: self.rate[k],
                    mag_ut: r.tr_mul(&segment.rest.field_ut),
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
        || log.rows[from].piston_mm != log.rows[to - 1].piston_mm || bin.idle_s < bin.lasting_s;
    let middle = (from + to - 1) / 2;
    if follows_motors && moving() {
        from..to
    } else {
        middle..middle + 1
    }
}

/// A rotation as a matrix.
fn matrix(q: UnitQuaternion<f64>) -> Matrix3<f64> {
    q.to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tip::Rig;
    use crate::log::bend_log::BendLog;
    use crate::model::{Line, nominal_theta};

    /// A log of the tracker alone: rest, then every bellow longer in turn.
    #[test]
    fn a_log_without_an_imu_is_compared_with_the_tracker() {
        let rig = Rig::default();
        let n = 4000;
        let piston = |k: usize| {
            let mm = 0.01 * (k % 1000) as f64;
            Vector3::from_fn(|i, _| if k / 1000 == i + 1 { mm } else { 0.0 })
        };
        let log = BendLog {
            t_s: (0..n).map(|k| k as f64 * 0.01).collect(),
            command: vec![Vector3::repeat(f64::NAN); n],
            piston_mm: (0..n).map(piston).collect(),
            reference: Some(vec![Some(UnitQuaternion::identity()); n]),
            ..BendLog::default()
        };
        let log = Observed::new(&log, &rig).unwrap();
        let line = Line {
            k_epsilon: 2.2,
            k_lambda_mm: 0.8,
        };
        let theta = nominal_theta(&[line; 3], 0.02);
        let left = residuals(&log, &Model::new(&[]), &theta);
        let largest = |q: Quantity| left[q].iter().map(Vector3::norm).fold(0.0, f64::max);
        assert!(largest(Quantity::Reference) > 0.1);
        assert!(Quantity::ALL[1..].iter().all(|q| largest(*q) == 0.0));
    }
}
