//! Scores on blocks that the fit has not seen.
//!
//! Contiguous blocks are left out in turn. The model runs through the whole log from the pistons alone, and the
//! left-out blocks are scored. Scores for two block lengths are averaged: long blocks, which a slow effect cannot
//! bridge, and short ones, which can date an event. A fit without a block starts at the full fit and descends along the tangent there
//! until a step gains next to nothing; its prediction is a full run.

use crate::diagnosis::tip::fit::{BaseFit, LeastSquares, Sums, dates, step, weighted};
use crate::diagnosis::tip::model::{Model, Motion, Residuals, every_bin, residuals};
use crate::diagnosis::tip::observed::{BIN_S, Observed, PerQuantity, Quantity};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Least reduction of a quantity's RMSE that is attributed to an effect, degrees or °/s.
pub const CLAIM_DEG: f64 = 0.3;
/// Lengths of left-out blocks, s.
pub const BLOCKS_S: [f64; 2] = [12.0, 1.5];
/// Mean square that noise alone leaves in any block, in units of the bins' variances.
const FLOOR: f64 = 0.03;
/// Margin at either end of a block that is neither fitted nor scored, s.
const MARGIN_S: f64 = 0.3;
/// Damping of the steps to a fit without a block.
const DAMPING: f64 = 1e-4;
/// Most of these steps.
const STEPS: usize = 5;
/// Relative gain of a step below which it is the last.
const CONVERGED: f64 = 1e-3;
/// Times a step is shortened, by [`SHORTER`] each, before it is given up.
const ATTEMPTS: usize = 3;
/// Factor by which a step that raises the cost is shortened.
const SHORTER: f64 = 0.3;

/// Held-out residual energies.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// RMSE of each quantity over the left-out blocks, degrees (°/s for the gyroscope); 0 where missing.
    pub rmse_deg: PerQuantity<f64>,
    /// Energy of each long block summed over the quantities, deg²; the blocks add up to [`HeldOut::energy`].
    pub blocks: Vec<f64>,
    /// Residuals of every bin as predicted when its long block was left out; 0 in the margins.
    pub residual: Residuals,
    /// [`density`] of each quantity over the long blocks and over the short ones.
    pub density: [PerQuantity<f64>; 2],
}

impl HeldOut {
    /// Energy over all quantities, deg².
    pub fn energy(&self) -> f64 {
        self.rmse_deg.0.iter().map(|e| e * e).sum()
    }

    /// Largest reduction of any quantity's RMSE from these scores to others, degrees or °/s.
    pub fn gain(&self, to: &Self) -> f64 {
        let gained = Quantity::ALL.map(|q| self.rmse_deg[q] - to.rmse_deg[q]);
        gained.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Leaves blocks of both lengths out of a fit.
pub fn leave_out(fit: &BaseFit<'_>) -> HeldOut {
    let log = fit.problem.log;
    let [mut long, short] = BLOCKS_S.map(|length_s| {
        let folds = folds(log, length_s);
        score(log, predicted(fit, &folds), |k| folds[k].is_some())
    });
    long.density[1] = density(log, &short.residual, BLOCKS_S[1]);
    for (a, b) in long.rmse_deg.0.iter_mut().zip(short.rmse_deg.0) {
        *a = ((*a * *a + b * b) / 2.0).sqrt();
    }
    let (sum, energy) = (long.blocks.iter().sum::<f64>(), long.energy());
    if sum > 0.0 {
        long.blocks.iter_mut().for_each(|b| *b *= energy / sum);
    }
    long
}

/// Fold in which each bin is left out (0 or 1); `None` within the margin to the other fold.
fn folds(log: &Observed, length_s: f64) -> Vec<Option<usize>> {
    let of = |t_s: f64| {
        let phase = (t_s - log.start_s()) / length_s;
        let inside = (MARGIN_S..=length_s - MARGIN_S).contains(&(phase.fract() * length_s));
        inside.then_some(phase.floor() as usize % 2)
    };
    log.bins.iter().map(|b| of(b.t_s)).collect()
}

/// Residuals of each bin as predicted by the fit that has not seen it.
fn predicted(fit: &BaseFit<'_>, folds: &[Option<usize>]) -> Residuals {
    let bins = folds.len();
    let parts = fit.tangent.parts(&fit.point, bins, 2, |k| folds[k]);
    let mut residual = Residuals::from_fn(|_| vec![Vector3::zeros(); bins]);
    for fold in 0..2 {
        let mut sums = parts[1 - fold].clone();
        sums.add_prior(&fit.problem, &fit.point.theta);
        let refitted = refitted(fit, sums, &|k| folds[k] == Some(1 - fold));
        for k in (0..bins).filter(|&k| folds[k] == Some(fold)) {
            for (all, these) in residual.0.iter_mut().zip(&refitted.0) {
                all[k] = these[k];
            }
        }
    }
    residual
}

/// Residuals of the fit without a fold, which starts at `point` with `sums` over the other fold. Nothing but the bins around an event
/// tells its time, so the dates of the whole log are kept.
fn refitted(fit: &BaseFit<'_>, mut sums: Sums, mask: &impl Fn(usize) -> bool) -> Residuals {
    let (problem, point) = (&fit.problem, &fit.point);
    let mut bounds = problem.bounds.clone();
    for i in dates(problem) {
        (bounds[i].low, bounds[i].high) = (point.theta[i], point.theta[i]);
    }
    let at = |theta: Vec<f64>, motion: &Motion| Refit::new(problem, theta, motion, mask);
    let mut here = at(point.theta.clone(), &point.motion);
    for _ in 0..STEPS {
        let Some(mut theta) = step(&here.theta, &bounds, &sums, DAMPING) else {
            break;
        };
        let mut next = None;
        for _ in 0..ATTEMPTS {
            next = Some(at(theta.clone(), &problem.motion(&theta))).filter(|n| n.cost <= here.cost);
            if next.is_some() {
                break;
            }
            let pairs = theta.iter_mut().zip(&here.theta);
            pairs.for_each(|(t, p)| *t = p + (*t - p) * SHORTER);
        }
        let Some(next) = next else { break };
        let gained = 1.0 - next.cost / here.cost;
        here = next;
        if gained < CONVERGED {
            break;
        }
        sums.gradient = fit.tangent.gradient(problem, &here.theta, &here.fitted);
    }
    here.residual
}

/// A point of the fit without a fold.
struct Refit {
    theta: Vec<f64>,
    /// Residuals of all bins.
    residual: Residuals,
    /// Weighted residuals of the bins that are fitted; 0 for the others.
    fitted: Vec<f64>,
    /// Sum of their squares and of those of the priors.
    cost: f64,
}

impl Refit {
    fn new(
        problem: &LeastSquares<'_>,
        theta: Vec<f64>,
        motion: &Motion,
        mask: &impl Fn(usize) -> bool,
    ) -> Self {
        let residual = problem.sensed(&theta, motion, mask);
        let mut fitted = weighted(problem.log, &residual);
        let rows = fitted
            .chunks_exact_mut(3 * problem.log.quantities().count())
            .enumerate();
        rows.filter(|(k, _)| !mask(*k))
            .for_each(|(_, r)| r.fill(0.0));
        let cost = fitted.iter().map(|r| r * r).sum::<f64>() + problem.prior(&theta);
        Self {
            theta,
            residual,
            fitted,
            cost,
        }
    }
}

/// Mean over the blocks of the logarithm of the mean square of each quantity's left-out residuals, in units of their variances: the
/// negative predictive density of residuals whose variance is unknown. No sum mixes units, and one block with an error of form counts
/// as one block.
pub fn density(log: &Observed, residual: &Residuals, block_s: f64) -> PerQuantity<f64> {
    let of = |q: Quantity| {
        let mut blocks: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
        let scored = log
            .bins
            .iter()
            .zip(&residual[q])
            .filter(|(b, r)| b.weight[q] > 0.0 && **r != Vector3::zeros());
        for (bin, r) in scored {
            let block = ((bin.t_s - log.start_s()) / block_s) as usize;
            let sum = blocks.entry(block).or_default();
            sum.0 += bin.weight[q].powi(2) * r.norm_squared();
            sum.1 += 3.0 * bin.lasting_s / BIN_S;
        }
        let logs = blocks.values().map(|(square, n)| (square / n + FLOOR).ln());
        logs.sum::<f64>() / blocks.len().max(1) as f64
    };
    PerQuantity::from_fn(of)
}

/// Scores on all bins of a model with these parameters.
pub fn scored(log: &Observed, model: &Model<'_>, theta: &[f64]) -> HeldOut {
    score(log, residuals(log, model, theta), every_bin)
}

/// RMSE of each quantity and energy of each block of the residuals of the `used` bins.
pub fn score(log: &Observed, residual: Residuals, used: impl Fn(usize) -> bool) -> HeldOut {
    let count = (log.duration_s() / BLOCKS_S[0]).ceil() as usize + 1;
    // per block and quantity: weighted squares and weights
    let mut sums = vec![PerQuantity([(0.0, 0.0); 4]); count];
    for (k, bin) in log.bins.iter().enumerate().filter(|(k, _)| used(*k)) {
        let at = ((bin.t_s - log.start_s()) / BLOCKS_S[0]) as usize;
        for q in log.quantities() {
            let w = bin.weight[q].powi(2);
            let s = &mut sums[at.min(count - 1)][q];
            *s = (s.0 + w * residual[q][k].norm_squared(), s.1 + w);
        }
    }
    let total = PerQuantity::from_fn(|q| sums.iter().map(|b| b[q].1).sum::<f64>());
    let square = 1f64.to_degrees().powi(2);
    let rmse_deg = PerQuantity::from_fn(|q| {
        let e: f64 = sums.iter().map(|b| b[q].0).sum();
        match total[q] > 0.0 {
            true => (e / total[q] * square).sqrt(),
            false => 0.0,
        }
    });
    let block = |b: &PerQuantity<(f64, f64)>| {
        let scored = log.quantities().filter(|&q| total[q] > 0.0);
        scored.map(|q| b[q].0 / total[q] * square).sum()
    };
    let blocks = sums.iter().map(block).collect();
    let density = [density(log, &residual, BLOCKS_S[0]), PerQuantity::default()];
    HeldOut {
        rmse_deg,
        blocks,
        residual,
        density,
    }
}
