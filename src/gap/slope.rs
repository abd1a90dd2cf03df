//! Tangent of the residuals to the parameters, and sums over it.
//!
//! Forward differences; the motion is run again only for parameters that change it. A tangent is kept
//! because it serves twice: for the steps of a fit, and for the fits without a block, which are so close
//! to the full one that a step along the tangent reaches them.

use crate::gap::begin::Ground;
use crate::gap::chain::{Model, NOMINAL, run};
use crate::gap::fit::{Bound, PRIOR_SLOPE, Point, nudge, weighted};
use crate::gap::observe::Observed;
use crate::gap::sense::sense;
use nalgebra::{DMatrix, DVector};

/// Rows that are summed at a time: what fits the first cache.
const CHUNK_BINS: usize = 32;

/// ∂(weighted residuals)/∂(θ in units of scale), column by column.
#[derive(Debug, Clone)]
pub struct Tangent {
    columns: Vec<Vec<f64>>,
}

/// One column: forward difference.
fn column(log: &Observed, model: &Model<'_>, point: &Point, bounds: &[Bound], all: &[f64], c: usize) -> Vec<f64> {
    let (mut moved, b) = (point.theta.clone(), &bounds[c]);
    let h = nudge(moved[c], b);
    moved[c] += h;
    let scored = if model.sensing_only(c) {
        sense(log, model, &moved, &point.motion, all)
    } else {
        sense(log, model, &moved, &run(log, model, &moved), all)
    };
    let mut column = weighted(log, &scored);
    let per_scale = b.scale / h;
    column.iter_mut().zip(&point.residual).for_each(|(x, r)| *x = (*x - r) * per_scale);
    column
}

/// Normal matrix and slope `Jᵀr` of a sum of squares, priors in it.
#[derive(Debug, Clone)]
pub struct Sums {
    /// `JᵀJ`.
    pub normal: DMatrix<f64>,
    /// `Jᵀr`.
    pub slope: DVector<f64>,
}

impl Tangent {
    /// At a point.
    #[must_use]
    pub fn new(log: &Observed, model: &Model<'_>, point: &Point, bounds: &[Bound], all: &[f64]) -> Self {
        Self { columns: (0..bounds.len()).map(|c| column(log, model, point, bounds, all, c)).collect() }
    }

    /// At a point that differs from `ground` by an effect which does little there: only that effect's
    /// columns are new.
    #[must_use]
    pub fn grown(log: &Observed, model: &Model<'_>, point: &Point, bounds: &[Bound], all: &[f64], ground: &Ground<'_>) -> Self {
        let mut columns = ground.tangent.columns[..NOMINAL].to_vec();
        for (i, e) in model.effects.iter().enumerate() {
            let here = model.at[i]..model.at[i + 1];
            match ground.model.effects.iter().position(|x| x.name() == e.name()) {
                Some(k) => columns.extend_from_slice(&ground.tangent.columns[ground.model.at[k]..ground.model.at[k + 1]]),
                None => columns.extend(here.map(|c| column(log, model, point, bounds, all, c))),
            }
        }
        Self { columns }
    }

    /// Sums over all bins.
    #[must_use]
    pub fn sums(&self, point: &Point, bounds: &[Bound], bins: usize) -> Sums {
        let mut parts = self.parts(point, bins, 1, |_| Some(0));
        let mut sums = parts.swap_remove(0);
        sums.add_prior(point, bounds);
        sums
    }

    /// Sums over groups of bins, priors left out; `group` says which a bin belongs to.
    #[must_use]
    pub fn parts(&self, point: &Point, bins: usize, groups: usize, group: impl Fn(usize) -> Option<usize>) -> Vec<Sums> {
        let (n, stride) = (self.columns.len(), point.residual.len() / bins.max(1));
        let mut out = vec![Sums { normal: DMatrix::zeros(n, n), slope: DVector::zeros(n) }; groups];
        let mut from = 0;
        while from < bins {
            let of = group(from);
            let mut to = from + 1;
            while to < bins && to - from < CHUNK_BINS && group(to) == of {
                to += 1;
            }
            if let Some(sums) = of.and_then(|g| out.get_mut(g)) {
                let rows = from * stride..to * stride;
                for (a, column) in self.columns.iter().enumerate() {
                    let column = &column[rows.clone()];
                    for (b, other) in self.columns[..=a].iter().enumerate() {
                        sums.normal[(a, b)] += dot(column, &other[rows.clone()]);
                    }
                    sums.slope[a] += dot(column, &point.residual[rows.clone()]);
                }
            }
            from = to;
        }
        for sums in &mut out {
            for a in 0..n {
                for b in a + 1..n {
                    sums.normal[(a, b)] = sums.normal[(b, a)];
                }
            }
        }
        out
    }
}

impl Sums {
    /// Adds the priors.
    pub fn add_prior(&mut self, point: &Point, bounds: &[Bound]) {
        for (i, (t, b)) in point.theta.iter().zip(bounds).enumerate() {
            self.normal[(i, i)] += PRIOR_SLOPE * PRIOR_SLOPE;
            self.slope[i] += PRIOR_SLOPE * PRIOR_SLOPE * (t - b.start) / b.scale;
        }
    }

    /// Adds another.
    pub fn add(&mut self, other: &Self) {
        self.normal += &other.normal;
        self.slope += &other.slope;
    }
}

/// Sum of products in four lanes, which the compiler can hold in one register.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a4.remainder().iter().zip(b4.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a4.zip(b4) {
        for i in 0..4 {
            lanes[i] += x[i] * y[i];
        }
    }
    lanes.iter().sum::<f64>() + rest
}
