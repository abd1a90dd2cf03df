//! Scores on blocks that the fit has not seen, and the interval of the part of a gap that is closed there.
//!
//! Contiguous blocks are left out in turn. The model runs through the whole log from the pistons alone, and the
//! left-out blocks are scored. Scores for two block lengths are averaged: long blocks, which a slow effect cannot
//! bridge, and short ones, which can date an event. A fit without a block starts at the full fit and descends along the tangent there
//! until a step gains next to nothing; its prediction is a full run.

use crate::diagnosis::tip::fit::{BaseFit, Sums, step, weighted};
use crate::diagnosis::tip::model::{Motion, Residuals, every_bin, residuals, sense};
use crate::diagnosis::tip::observed::{BIN_S, Bin, Observed, PerQuantity, Quantity};
use crate::model::Model;
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
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
/// Standard deviation of the logarithm of what is left from one log of a unit to the next: 0.44 on the single effects
/// of `retroflex gap exam` with seeds 201 and 202, 0.45 on logs of another simulator.
const BETWEEN_LOGS: f64 = 0.45;
/// Least part of the gap that is left: the noise is not known more precisely.
const LEFT_MIN: f64 = 0.01;
/// Draws of the bootstrap.
const DRAWS: usize = 400;

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
    let parts: [Sums; 2] = fit.tangent.parts(&fit.point, folds);
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
    for event in problem.model.all_events() {
        for i in [Some(event.time), event.lasting].into_iter().flatten() {
            (bounds[i].low, bounds[i].high) = (point.theta[i], point.theta[i]);
        }
    }
    let at = |theta: Vec<f64>, motion: &Motion| {
        let residual = sense(problem.log, &problem.model, &theta, motion, mask);
        let mut fitted = weighted(problem.log, &residual);
        let rows = fitted.chunks_exact_mut(3 * problem.log.quantities().count());
        let unused = rows.enumerate().filter(|(k, _)| !mask(*k));
        unused.for_each(|(_, r)| r.fill(0.0));
        Refit {
            cost: fitted.iter().map(|r| r * r).sum::<f64>() + problem.prior(&theta),
            theta,
            residual,
            fitted,
        }
    };
    let mut here = at(point.theta.clone(), &point.motion);
    for _ in 0..STEPS {
        let Some(mut theta) = step(&here.theta, &bounds, &sums, DAMPING) else {
            break;
        };
        let mut tried = (0..ATTEMPTS).map(|_| {
            let next = at(theta.clone(), &problem.motion(&theta));
            let pairs = theta.iter_mut().zip(&here.theta);
            pairs.for_each(|(t, p)| *t = p + (*t - p) * SHORTER);
            next
        });
        let Some(next) = tried.find(|next| next.cost <= here.cost) else {
            break;
        };
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

/// Mean over the blocks of the logarithm of the mean square of each quantity's left-out residuals, in units of their variances: the
/// negative predictive density of residuals whose variance is unknown. No sum mixes units, and one block with an error of form counts
/// as one block.
pub fn density(log: &Observed, residual: &Residuals, block_s: f64) -> PerQuantity<f64> {
    let of = |q: Quantity| {
        let mut blocks: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
        let scored = |b: &Bin, r: &Vector3<f64>| b.weight[q] > 0.0 && *r != Vector3::zeros();
        let bins = log.bins.iter().zip(&residual[q]);
        for (bin, r) in bins.filter(|(b, r)| scored(b, r)) {
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
pub fn scored(log: &Observed, model: &Model, theta: &[f64]) -> HeldOut {
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
        (e / total[q].max(f64::MIN_POSITIVE) * square).sqrt()
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

/// The 95 % interval around `value`, the closed part on the whole log, from the scores of its long blocks: without the effect, with it, and of
/// the nominal model. `floor` is the energy of noise alone, deg².
///
/// A block bootstrap (Künsch 1989) gives the spread due to the contents of the log. A fresh log has another schedule,
/// and a law that differs from the true one leaves another part of it unexplained; one log cannot show that spread, so
/// a constant is added. Both spreads scale the part that is *left*, `1 − closed`; the interval is formed on its
/// logarithm.
pub fn closed_ci95(scores: [&HeldOut; 3], floor: f64, value: f64, seed: u64) -> [f64; 2] {
    let [before, after, nominal] = scores.map(|h| h.blocks.as_slice());
    let n = before.len().min(after.len()).min(nominal.len());
    if n == 0 {
        return [value, value];
    }
    let left = (1.0 - value).max(LEFT_MIN);
    let mut rng = StdRng::seed_from_u64(seed);
    let draw = |_| {
        let (mut without, mut with, mut gap) = (0.0, 0.0, -floor);
        for _ in 0..n {
            let i = rng.random_range(0..n);
            without += before[i];
            with += after[i];
            gap += nominal[i];
        }
        let closed = if gap > 0.0 {
            (without - with) / gap
        } else {
            value
        };
        ((1.0 - closed).max(LEFT_MIN) / left).ln().powi(2)
    };
    let square: f64 = (0..DRAWS).map(draw).sum();
    // an effect that closes nothing leaves the same on every log
    let between = BETWEEN_LOGS * value.clamp(0.0, 1.0);
    let half = 1.96 * (square / DRAWS as f64 + between * between).sqrt();
    let least = left * (-half).exp();
    let high = if least < LEFT_MIN {
        1.0
    } else {
        (1.0 - least).max(value).min(1.0)
    };
    [(1.0 - left * half.exp()).max(-1.0), high]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(blocks: &[f64]) -> HeldOut {
        HeldOut {
            rmse_deg: Default::default(),
            blocks: blocks.to_vec(),
            residual: Default::default(),
            density: Default::default(),
        }
    }

    #[test]
    fn the_interval_contains_the_value_and_uneven_blocks_widen_it() {
        let (even, after) = (held(&[1.0; 20]), held(&[0.1; 20]));
        let uneven = held(&std::array::from_fn::<f64, 20, _>(|i| {
            if i % 5 == 0 { 0.5 } else { 0.0 }
        }));
        let ci = |after: &HeldOut| closed_ci95([&even, after, &even], 0.0, 0.9, 1);
        let (a, b) = (ci(&after), ci(&uneven));
        assert!(a[0] < 0.9 && a[1] > 0.9 && a[1] <= 1.0, "{a:?}");
        assert!(b[0] < a[0], "{b:?} {a:?}");
    }

    #[test]
    fn an_effect_that_closes_nothing_has_an_interval_of_zero_width() {
        let even = held(&[1.0; 20]);
        let ci = closed_ci95([&even; 3], 0.0, 0.0, 1);
        assert!(ci[0].abs() < 1e-9 && ci[1].abs() < 1e-9, "{ci:?}");
    }
}
