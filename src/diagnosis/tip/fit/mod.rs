//! Joint fit of nominal gains and effect parameters.
//!
//! Levenberg-Marquardt (Marquardt 1963) on the weighted residuals of all quantities, with Gaussian priors on the
//! parameters. The recalibration comprises gravity, field and gyroscope bias, solved inside every evaluation
//! ([`mod@crate::diagnosis::tip::model::sense`]), and k_ε, k_λ and τ₀. What it closes is not credited to an effect.

pub mod candidate;
pub mod forecast;
pub mod holdout;
pub mod interval;
pub mod least_squares;
pub mod screen;
pub mod start;
pub mod tangent;

pub use candidate::Candidate;
pub use forecast::best_predicting;
pub use holdout::{BLOCKS_S, CLAIM_DEG, HeldOut, density, leave_out, score, scored};
pub use interval::{Compared, closed_ci95};
pub use least_squares::{LeastSquares, PRIOR_SLOPE, Point, weighted};
pub use screen::{Alone, alone, schwarz, screen};
pub use start::{Start, best_start, dated_again, dates, stepped, vanishing};
pub use tangent::{BaseFit, Sums, Tangent};

use crate::diagnosis::tip::fit::least_squares::Bound;
use nalgebra::{DMatrix, DVector};

/// Relative gain of a step below which a fit has converged.
const CONVERGED: f64 = 1e-3;
/// Relative gain of a step above which its tangent is used for a second step.
const SECOND_STEP: f64 = 10.0 * CONVERGED;
/// Damping of the first step, relative to the diagonal of the normal matrix.
const DAMPING: f64 = 1e-3;
/// Dampings tried before a fit gives up.
const ATTEMPTS: usize = 6;

/// A fitted model.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Parameters: nominal, then effects.
    pub theta: Vec<f64>,
    /// Weighted sum of squares without the priors.
    pub cost: f64,
    /// Inverse of the normal matrix, for standard errors of white residuals.
    pub covariance: DMatrix<f64>,
    /// Information that the log gives about the parameters: half the logarithm of the determinant of the normal matrix over that of the
    /// priors alone (the Occam factor of Laplace's evidence, MacKay 1992).
    pub information: f64,
}

impl Fitted {
    /// The result of a fit.
    pub fn new(fit: &BaseFit<'_>) -> Self {
        let (bounds, normal) = (&fit.problem.bounds, fit.sums().normal);
        let n = bounds.len();
        let inverse = normal.clone().try_inverse();
        let inverse = inverse.unwrap_or_else(|| DMatrix::identity(n, n));
        let over_prior = |d: &f64| (d / PRIOR_SLOPE).ln();
        let roots = normal.cholesky().map(|c| c.l().diagonal());
        let information = roots.map_or(0.0, |d| d.iter().map(over_prior).sum());
        let scale = |i: usize| bounds[i].scale;
        let covariance = DMatrix::from_fn(n, n, |a, b| inverse[(a, b)] * scale(a) * scale(b));
        Self {
            theta: fit.point.theta.clone(),
            cost: fit.point.data(),
            covariance,
            information,
        }
    }
}

/// Fits from `start` with at most `rounds` accepted steps. After a last step within `CONVERGED` the tangent is that of the point before.
pub fn fit<'a>(problem: LeastSquares<'a>, start: &[f64], rounds: usize) -> BaseFit<'a> {
    let mut point = problem.at_clamped(start);
    let mut damping = DAMPING;
    for _ in 0..rounds {
        let tangent = Tangent::new(&problem, &point);
        let mut sums = tangent.sums(&problem, &point);
        let Some(mut next) = downhill(&problem, &point, &sums, &mut damping) else {
            return BaseFit {
                problem,
                point,
                tangent,
            };
        };
        if next.total() < (1.0 - SECOND_STEP) * point.total() {
            sums.gradient = tangent.gradient(&problem, &next.theta, &next.residual);
            let further = step(&next.theta, &problem.bounds, &sums, damping);
            let further = further.map(|theta| problem.at(theta));
            next = further.filter(|f| f.total() < next.total()).unwrap_or(next);
        }
        let gained = 1.0 - next.total() / point.total();
        point = next;
        if gained <= CONVERGED {
            return BaseFit {
                problem,
                point,
                tangent,
            };
        }
    }
    let tangent = Tangent::new(&problem, &point);
    BaseFit {
        problem,
        point,
        tangent,
    }
}

/// One damped step that lowers the sum of squares, if there is one.
fn downhill(
    problem: &LeastSquares<'_>,
    point: &Point,
    sums: &Sums,
    damping: &mut f64,
) -> Option<Point> {
    for _ in 0..ATTEMPTS {
        let next = problem.at(step(&point.theta, &problem.bounds, sums, *damping)?);
        if next.total() < point.total() {
            *damping = (*damping * 0.2).max(1e-7);
            return Some(next);
        }
        *damping *= 8.0;
    }
    None
}

/// Parameters after one damped Gauss-Newton step within the limits. A parameter that is at a limit and pushes against
/// it is held there, and the step is solved again; `None` if the normal matrix is singular.
pub fn step(theta: &[f64], bounds: &[Bound], sums: &Sums, damping: f64) -> Option<Vec<f64>> {
    let mut free: Vec<bool> = vec![true; theta.len()];
    for _ in 0..3 {
        let mut damped = sums.normal.clone();
        let mut gradient = sums.gradient.clone();
        for i in 0..theta.len() {
            if free[i] {
                damped[(i, i)] += damping * sums.normal[(i, i)].max(1e-9);
            } else {
                damped.row_mut(i).fill(0.0);
                damped.column_mut(i).fill(0.0);
                (damped[(i, i)], gradient[i]) = (1.0, 0.0);
            }
        }
        let step: DVector<f64> = damped.cholesky()?.solve(&gradient);
        let at = |i: usize| theta[i] - step[i] * bounds[i].scale;
        let target: Vec<f64> = (0..theta.len()).map(at).collect();
        let stuck = |i: usize| {
            let (t, b) = (theta[i], &bounds[i]);
            (t <= b.low && target[i] < b.low) || (t >= b.high && target[i] > b.high)
        };
        let held: Vec<usize> = (0..theta.len()).filter(|&i| free[i] && stuck(i)).collect();
        if held.is_empty() {
            let clamped = target
                .iter()
                .zip(bounds)
                .map(|(t, b)| t.clamp(b.low, b.high));
            return Some(clamped.collect());
        }
        held.into_iter().for_each(|i| free[i] = false);
    }
    Some(theta.to_vec())
}
