//! Tangent of the residuals to the parameters, and sums over it.
//!
//! Forward differences; the motion is run again only for parameters that change it. A tangent is kept
//! because it serves twice: for the steps of a fit, and for the fits without a block, which are so close
//! to the full one that a step along the tangent reaches them.

use crate::diagnosis::begin::BaseFit;
use crate::diagnosis::chain::{Model, NOMINAL, run};
use crate::diagnosis::fit::{Bound, PRIOR_SLOPE, Point, feedback_reversal, weighted};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::sense::sense;
use nalgebra::{DMatrix, DVector};

/// Rows that are summed at a time: what fits the first cache.
const CHUNK_BINS: usize = 32;

/// ∂(weighted residuals)/∂(θ in units of scale), column by column, in single precision: the step is
/// checked by a full run anyway.
#[derive(Debug, Clone)]
pub struct Tangent {
    columns: Vec<Vec<f32>>,
}

/// One column: forward difference.
fn column(log: &Observed, model: &Model<'_>, point: &Point, bounds: &[Bound], all: &[f64], c: usize) -> Vec<f32> {
    let (mut moved, b) = (point.theta.clone(), &bounds[c]);
    let h = feedback_reversal(moved[c], b);
    moved[c] += h;
    let scored = if model.sensing_only(c) {
        sense(log, model, &moved, &point.motion, all)
    } else {
        sense(log, model, &moved, &run(log, model, &moved), all)
    };
    let per_scale = b.scale / h;
    weighted(log, &scored).iter().zip(&point.residual).map(|(x, r)| ((x - r) * per_scale) as f32).collect()
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
    pub fn grown(log: &Observed, model: &Model<'_>, point: &Point, bounds: &[Bound], all: &[f64], base_fit: &BaseFit<'_>) -> Self {
        let mut columns = base_fit.tangent.columns[..NOMINAL].to_vec();
        for (i, e) in model.effects.iter().enumerate() {
            let here = model.at[i]..model.at[i + 1];
            match base_fit.model.effects.iter().position(|x| x.name() == e.name()) {
                Some(k) => columns.extend_from_slice(&base_fit.tangent.columns[base_fit.model.at[k]..base_fit.model.at[k + 1]]),
                None => columns.extend(here.map(|c| column(log, model, point, bounds, all, c))),
            }
        }
        Self { columns }
    }

    /// Number of parameters.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Adds the columns of another from `from` on.
    pub fn append(&mut self, other: Self, from: usize) {
        self.columns.extend(other.columns.into_iter().skip(from));
    }

    /// Sums over all bins.
    #[must_use]
    pub fn sums(&self, point: &Point, bounds: &[Bound], bins: usize) -> Sums {
        let mut parts = self.parts(point, bins, 1, |_| Some(0));
        let mut sums = parts.swap_remove(0);
        sums.add_prior(point, bounds);
        sums
    }

    /// `Jᵀr` for other residuals, priors in it.
    #[must_use]
    pub fn slope(&self, point: &Point, bounds: &[Bound]) -> DVector<f64> {
        let residual: Vec<f32> = point.residual.iter().map(|r| *r as f32).collect();
        let mut slope = DVector::from_iterator(self.columns.len(), self.columns.iter().map(|c| dot(c, &residual)));
        add_prior_slope(&mut slope, point, bounds);
        slope
    }

    /// Sums over groups of bins, priors left out; `group` says which a bin belongs to.
    #[must_use]
    pub fn parts(&self, point: &Point, bins: usize, groups: usize, group: impl Fn(usize) -> Option<usize>) -> Vec<Sums> {
        let (n, stride) = (self.columns.len(), point.residual.len() / bins.max(1));
        let residual: Vec<f32> = point.residual.iter().map(|r| *r as f32).collect();
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
                    sums.slope[a] += dot(column, &residual[rows.clone()]);
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
        for i in 0..bounds.len() {
            self.normal[(i, i)] += PRIOR_SLOPE * PRIOR_SLOPE;
        }
        add_prior_slope(&mut self.slope, point, bounds);
    }
}

fn add_prior_slope(slope: &mut DVector<f64>, point: &Point, bounds: &[Bound]) {
    for (i, (t, b)) in point.theta.iter().zip(bounds).enumerate() {
        slope[i] += PRIOR_SLOPE * PRIOR_SLOPE * (t - b.start) / b.scale;
    }
}

/// Sum of products in sixteen lanes, which the compiler can hold in registers.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    const LANES: usize = 16;
    let mut lanes = [0.0f32; LANES];
    let (a16, b16) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f32 = a16.remainder().iter().zip(b16.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a16.zip(b16) {
        for i in 0..LANES {
            lanes[i] += x[i] * y[i];
        }
    }
    f64::from(lanes.iter().sum::<f32>() + rest)
}
