//! A simulator beside a log: driven with the counted pistons of the log, it moves its tip, and what the sensors would have measured of that
//! motion is compared with what they did.
//!
//! Gravity, field and gyroscope bias are solved as for the nominal model ([`mod@sense`]). Parameters of the simulator are found by
//! Levenberg-Marquardt (Marquardt 1963) over runs of it. What is left is scored on blocks that the fit has not seen, along the tangent of
//! the fit, and the intervals are those of the jackknife over blocks (Efron 1982), because residuals of neighbouring bins are alike.

use crate::diagnosis::tip::fit::{BLOCKS_S, HeldOut, score, weighted};
use crate::diagnosis::tip::model::{Motion, Residuals, every_bin, sense};
use crate::diagnosis::tip::observed::Observed;
use crate::experiment::error::ExperimentError;
use crate::model::{Drive, Model, nominal_theta};
use crate::simulation::world::World;
use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};
use serde::Serialize;

/// Starting points along the range of each parameter.
const GRID: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];
/// Most steps of a fit.
const ROUNDS: usize = 12;
/// Relative gain of a step below which it is the last.
const CONVERGED: f64 = 1e-3;
/// Difference for the tangent, as a share of the range.
const DIFFERENCE: f64 = 0.01;
/// Damping of the first step, relative to the diagonal, and its largest.
const DAMPING: (f64, f64) = (1e-3, 1e3);

/// A parameter of the simulator and its range.
#[derive(Debug, Clone, PartialEq)]
pub struct Knob {
    /// Its name in `--param NAME=VALUE`.
    pub name: String,
    /// Least value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// A parameter that was fitted.
#[derive(Debug, Clone, Serialize)]
pub struct Fitted {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// The 95 % interval.
    pub ci95: [f64; 2],
    /// The interval is the whole range.
    #[serde(skip)]
    pub untold: bool,
}

/// A simulator beside a log.
#[derive(Debug, Clone)]
pub struct Compared {
    /// What it leaves of the log, on blocks that no fit has seen.
    pub held_out: HeldOut,
    /// What was fitted.
    pub params: Vec<Fitted>,
}

/// The motion of the tip of `world` at the instants of a log, from rest. The counts of a row hold until the next.
///
/// # Errors
/// [`ExperimentError`]: the world fails, or does not tell how its tip is oriented.
pub fn drive(world: &mut dyn World, log: &Observed) -> Result<Motion, ExperimentError> {
    let (period_s, step_mm) = (world.info().period_s, world.info().step_mm);
    let (rack, start_s) = (Drive { step_mm }, log.start_s());
    let (mut motion, mut row, mut n) = (Motion::with_capacity(log.instants.len()), 0, 0.0);
    let mut before: Option<UnitQuaternion<f64>> = None;
    while motion.len() < log.instants.len() {
        n += 1.0;
        let t_s = n * period_s;
        let next = |row: usize| log.rows.get(row + 1);
        while next(row).is_some_and(|next| next.t_s - start_s <= t_s) {
            row += 1;
        }
        let reply = world.step(&rack.steps(&log.rows[row].piston_mm))?;
        let now = reply.truth.ok_or(ExperimentError::NoReference)?.quat();
        let last = before.replace(now).unwrap_or(now);
        while let Some(at_s) = log.instants.get(motion.len()).map(|i| i.t_s - start_s) {
            if at_s > t_s {
                break;
            }
            let share = (1.0 - (t_s - at_s) / period_s).clamp(0.0, 1.0);
            let between = last.try_slerp(&now, share, 1e-9).unwrap_or(now);
            motion.push(between.to_rotation_matrix().into_inner());
        }
    }
    if let Some(back) = motion.first().map(|first| first.transpose()) {
        motion.iter_mut().for_each(|r| *r = back * *r);
    }
    Ok(motion)
}

/// What a motion leaves of a log.
fn residuals(log: &Observed, motion: &Motion) -> Residuals {
    let theta = nominal_theta(&[log.rig.prior; 3], log.rig.prior_lag_s);
    sense(log, &Model::new(&[]), &theta, motion, every_bin)
}

/// Compares with the log what `run` says of the simulator with these parameters, and fits the parameters.
///
/// # Errors
/// Those of `run`.
pub fn compare<E>(
    log: &Observed,
    knobs: &[Knob],
    mut run: impl FnMut(&[f64]) -> Result<Motion, E>,
) -> Result<Compared, E> {
    let value = |x: &DVector<f64>| -> Vec<f64> {
        let of = |(x, k): (&f64, &Knob)| k.low + x * (k.high - k.low);
        x.iter().zip(knobs).map(of).collect()
    };
    let mut at = |x: &DVector<f64>| Ok(residuals(log, &run(&value(x))?));
    let fitted = Fit::run(log, knobs.len(), &mut at)?;
    let blocks = Blocks::new(log, &fitted);
    let left = blocks.left_out(log, &fitted);
    let params = value(&fitted.x).into_iter().enumerate().map(|(i, value)| {
        let Knob { name, low, high } = &knobs[i];
        let wide = blocks.half_width(i) * (high - low);
        let ci95 = [value - wide, value + wide].map(|v| v.clamp(*low, *high));
        Fitted {
            name: name.clone(),
            value,
            ci95,
            untold: ci95 == [*low, *high],
        }
    });
    Ok(Compared {
        held_out: score(log, left, every_bin),
        params: params.collect(),
    })
}

/// A fit, whose parameters are shares of their ranges.
struct Fit {
    x: DVector<f64>,
    residual: Residuals,
    /// Change of the residuals with each parameter.
    tangent: Vec<Residuals>,
}

impl Fit {
    fn run<E>(
        log: &Observed,
        n: usize,
        at: &mut impl FnMut(&DVector<f64>) -> Result<Residuals, E>,
    ) -> Result<Self, E> {
        let cost = |r: &Residuals| weighted(log, r).iter().map(|r| r * r).sum::<f64>();
        let mut x = DVector::from_element(n, 0.5);
        let mut residual = at(&x)?;
        for i in 0..n {
            for start in GRID.into_iter().filter(|start| *start != 0.5) {
                let mut other = x.clone();
                other[i] = start;
                let r = at(&other)?;
                if cost(&r) < cost(&residual) {
                    (x, residual) = (other, r);
                }
            }
        }
        let (mut damping, mut tangent) = (DAMPING.0, tangent(&x, &residual, at)?);
        for _ in 0..ROUNDS.min(ROUNDS * n) {
            let (normal, gradient) = sums(log, &residual, &tangent, &every_bin);
            let other = stepped(&x, &normal, &gradient, damping);
            let r = at(&other)?;
            let gained = 1.0 - cost(&r) / cost(&residual).max(f64::MIN_POSITIVE);
            if gained <= 0.0 {
                damping *= 10.0;
                if damping > DAMPING.1 {
                    break;
                }
                continue;
            }
            (x, residual, damping) = (other, r, damping * 0.1);
            tangent = self::tangent(&x, &residual, at)?;
            if gained < CONVERGED {
                break;
            }
        }
        Ok(Self {
            x,
            residual,
            tangent,
        })
    }
}

/// Change of the residuals with each parameter.
fn tangent<E>(
    x: &DVector<f64>,
    residual: &Residuals,
    at: &mut impl FnMut(&DVector<f64>) -> Result<Residuals, E>,
) -> Result<Vec<Residuals>, E> {
    let of = |i: usize| {
        let (mut other, step) = (x.clone(), if x[i] > 0.5 { -DIFFERENCE } else { DIFFERENCE });
        other[i] += step;
        let mut change = at(&other)?;
        for (change, here) in change.0.iter_mut().zip(&residual.0) {
            for (c, h) in change.iter_mut().zip(here) {
                *c = (*c - h) / step;
            }
        }
        Ok(change)
    };
    (0..x.len()).map(of).collect()
}

/// Normal matrix and gradient over some bins.
fn sums(
    log: &Observed,
    residual: &Residuals,
    tangent: &[Residuals],
    used: &impl Fn(usize) -> bool,
) -> (DMatrix<f64>, DVector<f64>) {
    let n = tangent.len();
    let (mut normal, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
    for (k, bin) in log.bins.iter().enumerate().filter(|(k, _)| used(*k)) {
        for q in log.quantities() {
            let w = bin.weight[q].powi(2);
            for i in 0..n {
                gradient[i] += w * tangent[i][q][k].dot(&residual[q][k]);
                for j in 0..n {
                    normal[(i, j)] += w * tangent[i][q][k].dot(&tangent[j][q][k]);
                }
            }
        }
    }
    (normal, gradient)
}

/// The solution of the normal equations; 0 where they have none, or nothing is asked.
fn solved(normal: DMatrix<f64>, gradient: &DVector<f64>) -> DVector<f64> {
    let factor = (!gradient.is_empty()).then(|| normal.cholesky()).flatten();
    let zero = || DVector::zeros(gradient.len());
    factor.map_or_else(zero, |factor| factor.solve(gradient))
}

/// A damped step within the ranges.
fn stepped(
    x: &DVector<f64>,
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    damping: f64,
) -> DVector<f64> {
    let mut damped = normal.clone();
    for i in 0..x.len() {
        damped[(i, i)] += damping * normal[(i, i)] + f64::MIN_POSITIVE;
    }
    (x - solved(damped, gradient)).map(|x| x.clamp(0.0, 1.0))
}

/// The sums of each block.
struct Blocks {
    of: Vec<usize>,
    sums: Vec<(DMatrix<f64>, DVector<f64>)>,
}

impl Blocks {
    fn new(log: &Observed, fit: &Fit) -> Self {
        let block = |t_s: f64| ((t_s - log.start_s()) / BLOCKS_S[0]) as usize;
        let of: Vec<usize> = log.bins.iter().map(|bin| block(bin.t_s)).collect();
        let count = of.last().map_or(0, |last| last + 1);
        let one = |b| sums(log, &fit.residual, &fit.tangent, &|k: usize| of[k] == b);
        let sums = (0..count).map(one).collect();
        Self { of, sums }
    }

    /// The step of the fit to the blocks that `used` selects.
    fn step(&self, used: impl Fn(usize) -> bool) -> DVector<f64> {
        let n = self.sums.first().map_or(0, |s| s.1.len());
        let zero = (DMatrix::zeros(n, n), DVector::zeros(n));
        let blocks = self.sums.iter().enumerate().filter(|(b, _)| used(*b));
        let (normal, gradient) = blocks.fold(zero, |(n, g), (_, s)| (n + &s.0, g + &s.1));
        -solved(normal, &gradient)
    }

    /// Residuals of each block with the parameters of the other half of the blocks.
    fn left_out(&self, log: &Observed, fit: &Fit) -> Residuals {
        let steps = [0, 1].map(|half| self.step(|b| b % 2 != half));
        let mut left = fit.residual.clone();
        for q in log.quantities() {
            for (k, r) in left[q].iter_mut().enumerate() {
                let step = &steps[self.of[k] % 2];
                let change = fit.tangent.iter().zip(step.iter());
                *r += change.map(|(t, s)| t[q][k] * *s).sum::<Vector3<f64>>();
            }
        }
        left
    }

    /// Half the width of the 95 % interval of a parameter; infinite if the parameter changes nothing.
    fn half_width(&self, i: usize) -> f64 {
        if self.sums.iter().all(|s| s.0[(i, i)] == 0.0) {
            return f64::INFINITY;
        }
        let n = self.sums.len() as f64;
        let without = |left_out: usize| self.step(|b| b != left_out)[i];
        let steps: Vec<f64> = (0..self.sums.len()).map(without).collect();
        let mean = steps.iter().sum::<f64>() / n;
        let squares: f64 = steps.iter().map(|s| (s - mean).powi(2)).sum();
        let freedom = (n - 1.0).max(1.0);
        // quantile of Student's t (Abramowitz & Stegun 26.7.5)
        let t = 1.96 + 2.37 / freedom + 2.82 / freedom.powi(2);
        t * (squares * freedom / n).sqrt()
    }
}
