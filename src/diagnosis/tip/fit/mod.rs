//! Joint fit of nominal gains and effect parameters.
//!
//! Levenberg-Marquardt (Marquardt 1963) on the weighted residuals of all quantities, with Gaussian priors on the
//! parameters. The recalibration comprises gravity, field and gyroscope bias, solved inside every evaluation
//! ([`mod@crate::diagnosis::tip::model::sense`]), and k_ε, k_λ and τ₀. What it closes is not credited to an effect.

pub mod candidate;
pub mod forecast;
pub mod holdout;
pub mod least_squares;
pub mod modes;
pub mod screen;
pub mod start;
pub mod tangent;

pub use candidate::Candidate;
pub use forecast::best_predicting;
pub use holdout::{BLOCKS_S, CLAIM_DEG, HeldOut, closed_ci95, density, leave_out, score, scored};
pub use least_squares::{LeastSquares, PRIOR_SLOPE, Point, schwarz, weighted, within};
pub use modes::vanishing;
pub use screen::{Alone, alone, screen};
pub use start::{Start, best_start, dated_again, grown, stepped};
pub use tangent::{BaseFit, Sums, Tangent};

use crate::model::effects::Param;
use nalgebra::DVector;

/// Relative gain of a step below which a fit has converged.
const CONVERGED: f64 = 1e-3;
/// Relative gain of a step above which its tangent is used for a second step.
const SECOND_STEP: f64 = 10.0 * CONVERGED;
/// Damping of the first step, relative to the diagonal of the normal matrix.
const DAMPING: f64 = 1e-3;
/// Dampings tried before a fit gives up.
const ATTEMPTS: usize = 6;

/// Fits from `start` with at most `rounds` accepted steps. After a last step within `CONVERGED` the tangent is that of the point before.
pub fn fit<'a>(problem: LeastSquares<'a>, start: &[f64], rounds: usize) -> BaseFit<'a> {
    let start = within(start.iter().copied(), &problem.bounds);
    let (mut point, mut damping) = (problem.at(start), DAMPING);
    let mut tangent = Tangent::new(&problem, &point);
    for _ in 0..rounds {
        let mut sums = tangent.sums(&problem, &point);
        let Some(mut next) = downhill(&problem, &point, &sums, &mut damping) else {
            break;
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
            break;
        }
        tangent = Tangent::new(&problem, &point);
    }
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
pub fn step(theta: &[f64], bounds: &[Param], sums: &Sums, damping: f64) -> Option<Vec<f64>> {
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
            return Some(within(target, bounds));
        }
        held.into_iter().for_each(|i| free[i] = false);
    }
    Some(theta.to_vec())
}
