//! Joint fit of nominal gains and effect parameters.
//!
//! Levenberg-Marquardt (Marquardt 1963) on the weighted residuals of all kinds, with Gaussian priors on
//! the effects' parameters. Gravity, field and gyroscope bias are solved inside every evaluation
//! ([`crate::diagnosis::sense`]). Those, with k_ε, k_λ and τ₀, are the recalibration; nothing of what they close
//! is credited to an effect.

use crate::diagnosis::chain::{LAG_MAX_S, Model, Motion, NOMINAL, run};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::sense::{Scored, sense};
use crate::diagnosis::slope::{Sums, Tangent};
use crate::model::transmission::Line;
use nalgebra::{DMatrix, DVector};

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Parameters: nominal, then effects.
    pub theta: Vec<f64>,
    /// Weighted sum of squares, priors left out.
    pub cost: f64,
    /// Inverse of the normal matrix, for standard errors (white residuals assumed; callers inflate).
    pub covariance: DMatrix<f64>,
}

/// Prior and limits of one parameter.
#[derive(Debug, Clone, Copy)]
pub struct Bound {
    /// Mean of the prior.
    pub start: f64,
    /// Unit step of the fit.
    pub scale: f64,
    /// Least value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// Nominal parameters to start from.
#[must_use]
pub fn nominal_start(lines: &[Line; 3]) -> Vec<f64> {
    let mut theta: Vec<f64> = lines.iter().map(|l| (1.0 + l.k_epsilon).ln()).collect();
    theta.extend(lines.iter().map(|l| l.k_lambda_mm));
    theta.push(0.025);
    theta
}

/// Priors and limits of all parameters of a model.
#[must_use]
pub fn bounds(model: &Model<'_>) -> Vec<Bound> {
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
/// Relative gain of a step below which a fit is done.
const DONE: f64 = 1e-3;

/// How steeply the prior rises: residual per unit of scale.
pub(crate) const PRIOR_SLOPE: f64 = PRIOR / 3.0;

/// A point of the parameter space with everything that follows from it.
#[derive(Debug, Clone)]
pub struct Point {
    /// Parameters.
    pub theta: Vec<f64>,
    /// Motion of the tip.
    pub motion: Motion,
    /// Weighted residuals, bin by bin, the kinds that the log has.
    pub residual: Vec<f64>,
    /// Priors' part of the sum of squares.
    pub prior: f64,
}

impl Point {
    /// Runs the model.
    #[must_use]
    pub fn new(log: &Observed, model: &Model<'_>, bounds: &[Bound], theta: Vec<f64>, all: &[f64]) -> Self {
        let motion = run(log, model, &theta);
        let residual = weighted(log, &sense(log, model, &theta, &motion, all));
        let prior = Self::prior_of(&theta, bounds);
        Self { theta, motion, residual, prior }
    }

    /// What the priors add to a sum of squares.
    #[must_use]
    pub fn prior_of(theta: &[f64], bounds: &[Bound]) -> f64 {
        theta.iter().zip(bounds).map(|(t, b)| (PRIOR_SLOPE * (t - b.start) / b.scale).powi(2)).sum()
    }

    /// Sum of squares with the priors.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.data() + self.prior
    }

    /// Sum of squares of the data.
    #[must_use]
    pub fn data(&self) -> f64 {
        self.residual.iter().map(|r| r * r).sum()
    }
}

/// Weighted residuals as one vector: bin by bin, kind by kind, axis by axis.
#[must_use]
pub fn weighted(log: &Observed, scored: &Scored) -> Vec<f64> {
    let kinds: Vec<usize> = (0..4).filter(|&k| log.has[k]).collect();
    let mut r = Vec::with_capacity(log.bins.len() * kinds.len() * 3);
    for (i, bin) in log.bins.iter().enumerate() {
        for &k in &kinds {
            let v = scored.residual[k][i] * bin.weight[k];
            r.extend([v.x, v.y, v.z]);
        }
    }
    r
}

/// Fits from `start`; at most `rounds` accepted steps.
#[must_use]
pub fn fit(log: &Observed, model: &Model<'_>, start: &[f64], rounds: usize) -> Fitted {
    fit_with_slope(log, model, start, rounds, false).0
}

/// The same, with the tangent at the result if `tangent` asks for it.
#[must_use]
pub fn fit_with_slope(log: &Observed, model: &Model<'_>, start: &[f64], rounds: usize, tangent: bool) -> (Fitted, Option<Tangent>) {
    let bounds = bounds(model);
    let all = vec![1.0; log.bins.len()];
    let theta = start.iter().zip(&bounds).map(|(t, b)| t.clamp(b.low, b.high)).collect();
    let mut point = Point::new(log, model, &bounds, theta, &all);
    let (mut lambda, mut last) = (1e-3, None);
    for _ in 0..rounds {
        let slope = Tangent::new(log, model, &point, &bounds, &all);
        let mut sums = slope.sums(&point, &bounds, log.bins.len());
        let Some(mut next) = downhill(log, model, &bounds, &point, &sums, &mut lambda, &all) else {
            last = Some(slope);
            break;
        };
        // the tangent is dear and serves for a second step
        if next.total() < (1.0 - 10.0 * DONE) * point.total() {
            sums.slope = slope.slope(&next, &bounds);
            let further = step(&next.theta, &bounds, &sums, lambda).map(|theta| Point::new(log, model, &bounds, theta, &all));
            next = further.filter(|f| f.total() < next.total()).unwrap_or(next);
        }
        last = Some(slope);
        let gained = 1.0 - next.total() / point.total();
        point = next;
        // the tangent belongs to the point before unless the step was tiny
        if gained > DONE {
            last = None;
        } else {
            break;
        }
    }
    let slope = if tangent && last.is_none() { Some(Tangent::new(log, model, &point, &bounds, &all)) } else { last };
    let covariance = slope.as_ref().map_or_else(|| DMatrix::identity(bounds.len(), bounds.len()), |s| covariance(s, &point, &bounds, log));
    (Fitted { cost: point.data(), theta: point.theta, covariance }, slope.filter(|_| tangent))
}

fn covariance(slope: &Tangent, point: &Point, bounds: &[Bound], log: &Observed) -> DMatrix<f64> {
    let n = bounds.len();
    let inverse = slope.sums(point, bounds, log.bins.len()).normal.try_inverse().unwrap_or_else(|| DMatrix::identity(n, n));
    // back from units of scale
    DMatrix::from_fn(n, n, |a, b| inverse[(a, b)] * bounds[a].scale * bounds[b].scale)
}

/// One damped step that lowers the sum of squares, if there is one.
fn downhill(
    log: &Observed,
    model: &Model<'_>,
    bounds: &[Bound],
    point: &Point,
    sums: &Sums,
    lambda: &mut f64,
    all: &[f64],
) -> Option<Point> {
    for _ in 0..6 {
        let theta = step(&point.theta, bounds, sums, *lambda)?;
        let next = Point::new(log, model, bounds, theta, all);
        if next.total() < point.total() {
            *lambda = (*lambda * 0.2).max(1e-7);
            return Some(next);
        }
        *lambda *= 8.0;
    }
    None
}

/// The damped step itself, kept within the limits.
pub(crate) fn step(theta: &[f64], bounds: &[Bound], sums: &Sums, lambda: f64) -> Option<Vec<f64>> {
    let mut free: Vec<bool> = vec![true; theta.len()];
    for _ in 0..3 {
        let mut damped = sums.normal.clone();
        let mut slope = sums.slope.clone();
        for i in 0..theta.len() {
            if free[i] {
                damped[(i, i)] += lambda * sums.normal[(i, i)].max(1e-9);
            } else {
                damped.row_mut(i).fill(0.0);
                damped.column_mut(i).fill(0.0);
                (damped[(i, i)], slope[i]) = (1.0, 0.0);
            }
        }
        let step: DVector<f64> = damped.cholesky()?.solve(&slope);
        let wanted: Vec<f64> = theta.iter().zip(bounds).zip(step.iter()).map(|((t, b), s)| t - s * b.scale).collect();
        // what stands at a limit and pushes against it is held there, and the rest solved again
        let mut held = false;
        for (i, (w, b)) in wanted.iter().zip(bounds).enumerate() {
            let stuck = (theta[i] <= b.low && *w < b.low) || (theta[i] >= b.high && *w > b.high);
            if free[i] && stuck {
                (free[i], held) = (false, true);
            }
        }
        if !held {
            return Some(wanted.iter().zip(bounds).map(|(w, b)| w.clamp(b.low, b.high)).collect());
        }
    }
    Some(theta.to_vec())
}

/// Finite-difference step of a parameter, away from its upper limit.
pub(crate) fn feedback_reversal(value: f64, b: &Bound) -> f64 {
    let h = STEP * b.scale;
    if value + h > b.high { -h } else { h }
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
