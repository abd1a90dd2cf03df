//! Joint fit of nominal gains and effect parameters.
//!
//! Levenberg-Marquardt (Marquardt 1963) on the residuals of all kinds, with Gaussian priors on the
//! effects' parameters. What is linear is solved inside every evaluation (variable projection, Golub &
//! Pereyra 1973): the direction of gravity and the field in the base frame and the constant gyroscope
//! bias. Those, with k_ε, k_λ and τ₀, are the recalibration; nothing of what they close is credited to
//! an effect. The training mask leaves blocks out: they are predicted, never fitted.

use crate::effects::{Memory, Moment, Reading};
use crate::gap::chain::{LAG_MAX_S, Model, Motion, NOMINAL, run};
use crate::gap::observe::{G_M_S2, Observed, vee};
use crate::model::transmission::Line;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, UnitQuaternion, Vector3};

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

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Parameters: nominal, then effects.
    pub theta: Vec<f64>,
    /// Weighted sum of squares over the training bins, priors left out.
    pub cost: f64,
    /// Inverse of the normal matrix, for standard errors (white residuals assumed; callers inflate).
    pub covariance: DMatrix<f64>,
}

/// Prior and limits of one parameter.
#[derive(Debug, Clone, Copy)]
struct Bound {
    start: f64,
    scale: f64,
    low: f64,
    high: f64,
}

/// Nominal parameters to start from.
#[must_use]
pub fn nominal_start(lines: &[Line; 3]) -> Vec<f64> {
    let mut theta: Vec<f64> = lines.iter().map(|l| (1.0 + l.k_epsilon).ln()).collect();
    theta.extend(lines.iter().map(|l| l.k_lambda_mm));
    theta.push(0.025);
    theta
}

fn bounds(model: &Model<'_>) -> Vec<Bound> {
    let mut b = vec![Bound { start: 3.2f64.ln(), scale: 0.3, low: 0.0, high: 2.0 }; 3];
    b.extend([Bound { start: 0.87, scale: 0.4, low: 0.0, high: 3.0 }; 3]);
    b.push(Bound { start: 0.025, scale: 0.015, low: 0.002, high: LAG_MAX_S });
    for e in &model.effects {
        b.extend(e.params().iter().map(|p| Bound { start: p.start, scale: p.scale, low: p.low, high: p.high }));
    }
    b
}

/// Weight of a prior row against data whose neighbours are correlated.
const PRIOR: f64 = 6.0;
/// Finite-difference step as a fraction of a parameter's scale.
const STEP: f64 = 2e-3;

/// Sensor side: predicts all kinds from a motion, solves the linear nominal parameters on `mask`.
#[must_use]
pub fn sense(log: &Observed, model: &Model<'_>, theta: &[f64], motion: &Motion, mask: &[f64]) -> Scored {
    let imu = Imu::new(log, model, theta, motion);
    let changed = imu.changes(log, model, theta, motion);
    let (mut g, mut m, mut w) = (Vector3::zeros(), Vector3::zeros(), [1e-12; 2]);
    for (k, bin) in log.bins.iter().enumerate() {
        let (wa, wm) = ((bin.weight[1] * mask[k]).powi(2), (bin.weight[2] * mask[k]).powi(2));
        if wa > 0.0 {
            g += imu.mean[k] * (bin.acc - changed[k].0) * wa;
        }
        if wm > 0.0 {
            m += imu.mean[k] * (bin.mag - changed[k].1) * wm;
            w[0] += wm;
        }
    }
    let gravity = if g.norm() > 0.0 { g.normalize() * G_M_S2 } else { log.up_base * G_M_S2 };
    let field = m / w[0];
    let mut bias = Vector3::zeros();
    for (k, bin) in log.bins.iter().enumerate() {
        let wg = (bin.weight[3] * mask[k]).powi(2);
        if wg > 0.0 {
            bias += (bin.gyr - imu.rate[k] - changed[k].2) * wg;
            w[1] += wg;
        }
    }
    bias /= w[1];
    let mut s = Scored { residual: Default::default(), gyro_bias: bias, gravity, field };
    let size = field.norm().max(1.0);
    for (k, bin) in log.bins.iter().enumerate() {
        let present = |kind: usize, v: Vector3<f64>| if bin.weight[kind] > 0.0 { v } else { Vector3::zeros() };
        let a = &imu.mean[k];
        s.residual[0].push(if bin.weight[0] > 0.0 {
            vee(&(mean_rows(motion, bin.rows).transpose() * bin.reference))
        } else {
            Vector3::zeros()
        });
        s.residual[1].push(present(1, (bin.acc - changed[k].0 - a.tr_mul(&gravity)) / G_M_S2));
        s.residual[2].push(present(2, (bin.mag - changed[k].1 - a.tr_mul(&field)) / size));
        s.residual[3].push(present(3, bin.gyr - changed[k].2 - imu.rate[k] - bias));
    }
    s
}

fn mean_rows(motion: &Motion, (from, to): (usize, usize)) -> Matrix3<f64> {
    motion[from..to].iter().fold(Matrix3::zeros(), |s, r| s + r) / (to - from) as f64
}

/// Sensor in the base at rest, per bin.
struct Imu {
    mean: Vec<Matrix3<f64>>,
    rate: Vec<Vector3<f64>>,
    mount: Matrix3<f64>,
    latency_s: f64,
}

impl Imu {
    fn new(log: &Observed, model: &Model<'_>, theta: &[f64], motion: &Motion) -> Self {
        let latency_s: f64 = model.each(theta).map(|(e, p)| e.latency_s(p)).sum();
        let mount = model.each(theta).filter_map(|(e, p)| e.mount(p)).fold(UnitQuaternion::identity(), |a, b| a * b);
        let mount: Matrix3<f64> = mount.to_rotation_matrix().into_inner();
        let mut imu = Self { mean: Vec::with_capacity(log.bins.len()), rate: Vec::with_capacity(log.bins.len()), mount, latency_s };
        let mut before: Option<(Matrix3<f64>, f64)> = None;
        for bin in &log.bins {
            let (from, to) = bin.rows;
            let base = base_turn(log, model, theta, from);
            let mut mean = if latency_s > 0.0 {
                (from..to).fold(Matrix3::zeros(), |s, k| s + imu.late(log, motion, k)) / (to - from) as f64
            } else {
                mean_rows(motion, bin.rows)
            };
            let mut last = imu.late(log, motion, to - 1);
            if let Some(b) = base {
                (mean, last) = (b * mean, base_turn(log, model, theta, to - 1).unwrap_or(b) * last);
            }
            let t = log.t_s[to - 1];
            let turn = before.map_or(Vector3::zeros(), |(r, t0)| vee(&(r.transpose() * last)) / (t - t0));
            imu.rate.push(mount.tr_mul(&turn));
            imu.mean.push(mean * mount);
            before = Some((last, t));
        }
        imu
    }

    /// Motion as the sensor samples it: `latency_s` ago.
    fn late(&self, log: &Observed, motion: &Motion, k: usize) -> Matrix3<f64> {
        if self.latency_s <= 0.0 {
            return motion[k];
        }
        let dt = log.t_s[k] - if k > 0 { log.t_s[k - 1] } else { log.t_s[0] - 0.01 };
        let back = self.latency_s / dt;
        let (whole, part) = (back.floor() as usize, back.fract());
        let (a, b) = (motion[k.saturating_sub(whole)], motion[k.saturating_sub(whole + 1)]);
        a * (1.0 - part) + b * part
    }

    /// What sensor effects add to acc, mag and gyro, averaged over each bin.
    fn changes(
        &self,
        log: &Observed,
        model: &Model<'_>,
        theta: &[f64],
        motion: &Motion,
    ) -> Vec<(Vector3<f64>, Vector3<f64>, Vector3<f64>)> {
        let mut out = vec![(Vector3::zeros(), Vector3::zeros(), Vector3::zeros()); log.bins.len()];
        for (e, p) in model.each(theta).filter(|(e, _)| e.sensing_only() && e.mount(p_of(e, model, theta)).is_none()) {
            let mut memory = Memory::default();
            for (k, bin) in log.bins.iter().enumerate() {
                let (from, to) = bin.rows;
                let n = (to - from) as f64;
                for row in from..to {
                    let at = self.moment(log, row);
                    let r = self.late(log, motion, row) * self.mount;
                    let before = Reading {
                        acc_m_s2: r.tr_mul(&log.up_base) * G_M_S2,
                        gyro_rad_s: self.rate[k],
                        mag_ut: r.tr_mul(&log.field_base_ut),
                        r_base_sensor: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r)),
                    };
                    let mut reading = before;
                    e.sensor(p, &mut memory, &at, &mut reading);
                    out[k].0 += (reading.acc_m_s2 - before.acc_m_s2) / n;
                    out[k].1 += (reading.mag_ut - before.mag_ut) / n;
                    out[k].2 += (reading.gyro_rad_s - before.gyro_rad_s) / n;
                }
            }
        }
        out
    }

    fn moment(&self, log: &Observed, row: usize) -> Moment {
        Moment {
            t_s: log.t_s[row] - log.t_s[0],
            dt_s: if row == 0 { 0.01 } else { log.t_s[row] - log.t_s[row - 1] },
            counted_mm: log.piston_mm[row],
            up_base: log.up_base,
            k_epsilon: Vector3::repeat(2.2),
            r_mm: 4.04,
            idle_s: log.idle_s[row],
        }
    }
}

fn p_of<'p>(e: &&dyn crate::effects::Effect, model: &Model<'_>, theta: &'p [f64]) -> &'p [f64] {
    let i = model.effects.iter().position(|x| x.name() == e.name()).unwrap_or(0);
    model.of(theta, i)
}

fn base_turn(log: &Observed, model: &Model<'_>, theta: &[f64], row: usize) -> Option<Matrix3<f64>> {
    let at = Moment {
        t_s: log.t_s[row] - log.t_s[0],
        dt_s: 0.01,
        counted_mm: Vector3::zeros(),
        up_base: log.up_base,
        k_epsilon: Vector3::zeros(),
        r_mm: 4.04,
        idle_s: 0.0,
    };
    model.each(theta).find_map(|(e, p)| e.base(p, &at)).map(|q| q.to_rotation_matrix().into_inner())
}

/// Weighted residuals of the training bins as one vector, priors appended.
fn stacked(log: &Observed, scored: &Scored, mask: &[f64], theta: &[f64], bounds: &[Bound]) -> DVector<f64> {
    let mut r = Vec::with_capacity(log.bins.len() * 12 + theta.len());
    for kind in (0..4).filter(|&k| log.has[k]) {
        for ((bin, v), m) in log.bins.iter().zip(&scored.residual[kind]).zip(mask) {
            let w = bin.weight[kind] * m;
            r.extend([v.x * w, v.y * w, v.z * w]);
        }
    }
    r.extend(theta.iter().zip(bounds).map(|(t, b)| PRIOR * (t - b.start) / (3.0 * b.scale)));
    DVector::from_vec(r)
}

/// Fits from `start`; at most `rounds` accepted steps.
#[must_use]
pub fn fit(log: &Observed, model: &Model<'_>, start: &[f64], mask: &[f64], rounds: usize) -> Fitted {
    let bounds = bounds(model);
    let mut theta: Vec<f64> = start.iter().zip(&bounds).map(|(t, b)| t.clamp(b.low, b.high)).collect();
    let mut motion = run(log, model, &theta);
    let mut r = stacked(log, &sense(log, model, &theta, &motion, mask), mask, &theta, &bounds);
    let (mut lambda, mut normal) = (1e-3, DMatrix::identity(theta.len(), theta.len()));
    for _ in 0..rounds {
        let j = jacobian(log, model, &theta, &motion, &r, mask, &bounds);
        normal = j.tr_mul(&j);
        let slope = j.tr_mul(&r);
        let Some(next) = downhill(log, model, mask, &bounds, &theta, &r, &normal, &slope, &mut lambda) else {
            break;
        };
        let gained = 1.0 - next.2.norm_squared() / r.norm_squared();
        (theta, motion, r) = next;
        if gained < 3e-4 {
            break;
        }
    }
    let data = r.len() - theta.len();
    let covariance = normal.try_inverse().unwrap_or_else(|| DMatrix::identity(theta.len(), theta.len()));
    // back from units of scale
    let covariance = DMatrix::from_fn(theta.len(), theta.len(), |a, b| covariance[(a, b)] * bounds[a].scale * bounds[b].scale);
    Fitted { cost: r.rows(0, data).norm_squared(), theta, covariance }
}

type Point = (Vec<f64>, Motion, DVector<f64>);

#[allow(clippy::too_many_arguments)]
fn downhill(
    log: &Observed,
    model: &Model<'_>,
    mask: &[f64],
    bounds: &[Bound],
    theta: &[f64],
    r: &DVector<f64>,
    normal: &DMatrix<f64>,
    slope: &DVector<f64>,
    lambda: &mut f64,
) -> Option<Point> {
    for _ in 0..6 {
        let mut damped = normal.clone();
        for i in 0..theta.len() {
            damped[(i, i)] += *lambda * normal[(i, i)].max(1e-9);
        }
        let step = damped.cholesky()?.solve(slope);
        let next: Vec<f64> = theta.iter().zip(bounds).zip(step.iter()).map(|((t, b), s)| (t - s * b.scale).clamp(b.low, b.high)).collect();
        let motion = run(log, model, &next);
        let after = stacked(log, &sense(log, model, &next, &motion, mask), mask, &next, bounds);
        if after.norm_squared() < r.norm_squared() {
            *lambda = (*lambda * 0.2).max(1e-7);
            return Some((next, motion, after));
        }
        *lambda *= 8.0;
    }
    None
}

/// ∂(residuals)/∂(θ in units of scale), forward differences; the motion is run again only for
/// parameters that change it.
fn jacobian(
    log: &Observed,
    model: &Model<'_>,
    theta: &[f64],
    motion: &Motion,
    r: &DVector<f64>,
    mask: &[f64],
    bounds: &[Bound],
) -> DMatrix<f64> {
    let mut j = DMatrix::zeros(r.len(), theta.len());
    for (c, b) in bounds.iter().enumerate() {
        let mut moved = theta.to_vec();
        let h = STEP * b.scale * if theta[c] + STEP * b.scale > b.high { -1.0 } else { 1.0 };
        moved[c] += h;
        let after = if model.sensing_only(c) {
            stacked(log, &sense(log, model, &moved, motion, mask), mask, &moved, bounds)
        } else {
            let motion = run(log, model, &moved);
            stacked(log, &sense(log, model, &moved, &motion, mask), mask, &moved, bounds)
        };
        j.set_column(c, &((after - r) * (b.scale / h)));
    }
    j
}

/// Parameters of a model with more effects, from a fit of one with fewer: shared effects keep theirs.
#[must_use]
pub fn extend(from: &Model<'_>, theta: &[f64], to: &Model<'_>, fresh: &[f64]) -> Vec<f64> {
    let mut out = theta[..NOMINAL].to_vec();
    for e in &to.effects {
        match from.effects.iter().position(|x| x.name() == e.name()) {
            Some(i) => out.extend_from_slice(from.of(theta, i)),
            None => out.extend_from_slice(fresh),
        }
    }
    out
}
