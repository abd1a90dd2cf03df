//! Tangent of the residuals with respect to the parameters, and sums over it.
//!
//! Forward differences; the motion is run again only for parameters that change it. A tangent serves the steps of a
//! fit, the fits without a block, which are close to the full fit, and the choice of the pairs of effects that are worth a fit.

use crate::diagnosis::tip::fit::{LeastSquares, PRIOR_SLOPE, Point};
use crate::model::NOMINAL;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Bins summed at a time: 32 bins × 12 rows × 4 bytes × about 20 columns fit the first-level cache.
const CHUNK_BINS: usize = 32;
/// Finite-difference step as a fraction of a parameter's scale.
const STEP: f64 = 2e-3;

/// ∂(weighted residuals)/∂(θ in units of scale), column by column, in single precision; a full run checks each step.
#[derive(Debug, Clone)]
pub struct Tangent {
    /// The columns.
    pub columns: Vec<Vec<f32>>,
}

/// Normal matrix and gradient of a sum of squares.
#[derive(Debug, Clone)]
pub struct Sums {
    /// `JᵀJ`.
    pub normal: DMatrix<f64>,
    /// `Jᵀr`.
    pub gradient: DVector<f64>,
}

/// A finished fit.
pub struct BaseFit<'a> {
    /// Its problem.
    pub problem: LeastSquares<'a>,
    /// Its result.
    pub point: Point,
    /// The tangent at the result.
    pub tangent: Tangent,
}

/// Column `c` of the tangent at a point; a parameter of an `absent` mode changes nothing.
fn column(problem: &LeastSquares<'_>, point: &Point, c: usize, absent: bool) -> Vec<f32> {
    if absent {
        return vec![0.0; point.residual.len()];
    }
    let (mut moved, b) = (point.theta.clone(), &problem.bounds[c]);
    // away from the upper limit
    let h = STEP * b.scale;
    let h = if moved[c] + h > b.high { -h } else { h };
    moved[c] += h;
    let motion = (!problem.model.sensing_only(c)).then(|| problem.motion(&moved));
    let residual = problem.residual(&moved, motion.as_ref().unwrap_or(&point.motion));
    let per_scale = b.scale / h;
    let moved = residual.iter().zip(&point.residual);
    moved.map(|(x, r)| ((x - r) * per_scale) as f32).collect()
}

impl Tangent {
    /// The tangent at a point.
    pub fn new(problem: &LeastSquares<'_>, point: &Point) -> Self {
        let absent = problem.model.absent(&point.theta);
        let columns = absent.par_iter().enumerate();
        Self {
            columns: columns
                .map(|(c, absent)| column(problem, point, c, *absent))
                .collect(),
        }
    }

    /// The tangent at a point that adds a small effect to a base fit: only the columns of that effect are computed.
    pub fn grown(problem: &LeastSquares<'_>, point: &Point, base: &BaseFit<'_>) -> Self {
        let (model, known) = (&problem.model, &base.problem.model);
        let absent = model.absent(&point.theta);
        let mut columns = base.tangent.columns[..NOMINAL].to_vec();
        for (i, e) in model.effects.iter().enumerate() {
            match known.position(e.name()) {
                Some(k) => columns.extend_from_slice(known.of(&base.tangent.columns, k)),
                None => {
                    columns.extend(model.place(i).map(|c| column(problem, point, c, absent[c])))
                }
            }
        }
        Self { columns }
    }

    /// Sums over all bins without the priors.
    pub fn whole(&self, point: &Point, bins: usize) -> Sums {
        let [whole] = self.parts(point, &vec![Some(0); bins]);
        whole
    }

    /// Sums over all bins, including the priors.
    pub fn sums(&self, problem: &LeastSquares<'_>, point: &Point) -> Sums {
        let mut sums = self.whole(point, problem.log.bins.len());
        sums.add_prior(problem, &point.theta);
        sums
    }

    /// `Jᵀr` with the residuals of other parameters, including the priors.
    pub fn gradient(
        &self,
        problem: &LeastSquares<'_>,
        theta: &[f64],
        residual: &[f64],
    ) -> DVector<f64> {
        let residual: Vec<f32> = residual.iter().map(|r| *r as f32).collect();
        let width = self.columns.len();
        let mut gradient = DVector::from_fn(width, |c, _| dot(&self.columns[c], &residual));
        add_prior_gradient(&mut gradient, problem, theta);
        gradient
    }

    /// Sums over `N` groups of bins without the priors, from the group of each bin.
    pub fn parts<const N: usize>(&self, point: &Point, groups: &[Option<usize>]) -> [Sums; N] {
        let (n, stride) = (
            self.columns.len(),
            point.residual.len() / groups.len().max(1),
        );
        let residual: Vec<f32> = point.residual.iter().map(|r| *r as f32).collect();
        let mut out: [Sums; N] = std::array::from_fn(|_| Sums {
            normal: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
        });
        let alike = groups.chunk_by(|a, b| a == b);
        let mut from = 0;
        for bins in alike.flat_map(|bins| bins.chunks(CHUNK_BINS)) {
            let rows = from..from + bins.len() * stride;
            from = rows.end;
            let Some(sums) = bins[0].and_then(|g| out.get_mut(g)) else {
                continue;
            };
            for (a, column) in self.columns.iter().enumerate() {
                let column = &column[rows.clone()];
                for (b, other) in self.columns[..=a].iter().enumerate() {
                    sums.normal[(a, b)] += dot(column, &other[rows.clone()]);
                }
                sums.gradient[a] += dot(column, &residual[rows.clone()]);
            }
        }
        for sums in &mut out {
            sums.normal.fill_upper_triangle_with_lower_triangle();
        }
        out
    }
}

impl Sums {
    /// Adds the priors.
    pub fn add_prior(&mut self, problem: &LeastSquares<'_>, theta: &[f64]) {
        for i in 0..problem.bounds.len() {
            self.normal[(i, i)] += PRIOR_SLOPE * PRIOR_SLOPE;
        }
        add_prior_gradient(&mut self.gradient, problem, theta);
    }
}

fn add_prior_gradient(gradient: &mut DVector<f64>, problem: &LeastSquares<'_>, theta: &[f64]) {
    for (i, (t, b)) in theta.iter().zip(&problem.bounds).enumerate() {
        gradient[i] += PRIOR_SLOPE * PRIOR_SLOPE * (t - b.start) / b.scale;
    }
}

/// Sum of products in sixteen lanes, which the compiler keeps in vector registers.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    const LANES: usize = 16;
    let mut lanes = [0.0f32; LANES];
    let (a16, b16) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a16.remainder().iter().zip(b16.remainder());
    let rest: f32 = rest.map(|(x, y)| x * y).sum();
    for (x, y) in a16.zip(b16) {
        for i in 0..LANES {
            lanes[i] += x[i] * y[i];
        }
    }
    f64::from(lanes.iter().sum::<f32>() + rest)
}
