//! Scores on blocks that the fit has not seen.
//!
//! Contiguous blocks are left out in turn, the model runs through the whole log from the pistons alone,
//! and the left-out blocks are scored. Two lengths of block stand beside each other: long ones, which a
//! slow effect cannot see across, and short ones, which can date an event. A fit without a block is a
//! step away from the full one along the tangent; the prediction with it is a full run.

use crate::diagnosis::chain::{Model, run};
use crate::diagnosis::fit::{Bound, Point, bounds, step};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::sense::{Scored, sense};
use crate::diagnosis::slope::{Sums, Tangent};
use nalgebra::Vector3;

/// Lengths of left-out blocks, s.
const BLOCKS_S: [f64; 2] = [12.0, 1.5];
/// Gap on either side of a left-out block that is neither fitted nor scored, s.
const MARGIN_S: f64 = 0.3;

/// Held-out residual energies.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// RMSE per kind over the left-out blocks, degrees (°/s for the gyroscope); 0 where missing.
    pub rmse_deg: [f64; 4],
    /// Energy per long block, summed over kinds, deg²; their sum is the energy.
    pub blocks: Vec<f64>,
    /// Residuals of every bin as predicted when its long block was left out; 0 in the margins.
    pub residual: [Vec<Vector3<f64>>; 4],
}

impl HeldOut {
    /// Energy over all kinds, deg².
    #[must_use]
    pub fn energy(&self) -> f64 {
        self.rmse_deg.iter().map(|e| e * e).sum()
    }
}

/// Leaves blocks of both lengths out of a fit that ended at `point`.
#[must_use]
pub fn leave_out(log: &Observed, model: &Model<'_>, point: &Point, tangent: &Tangent) -> HeldOut {
    let bounds = bounds(model);
    let [mut long, short] = BLOCKS_S.map(|length_s| {
        let folds = folds(log, length_s);
        let (residual, used) = predicted(log, model, point, tangent, &bounds, &folds);
        score(log, residual, &used)
    });
    for (a, b) in long.rmse_deg.iter_mut().zip(short.rmse_deg) {
        *a = ((*a * *a + b * b) / 2.0).sqrt();
    }
    let (sum, energy) = (long.blocks.iter().sum::<f64>(), long.energy());
    if sum > 0.0 {
        long.blocks.iter_mut().for_each(|b| *b *= energy / sum);
    }
    long
}

/// Which fold each bin is left out in (0 or 1); `None` if it is too near the other fold to be used.
fn folds(log: &Observed, length_s: f64) -> Vec<Option<usize>> {
    let t0 = log.start_s();
    let of = |t_s: f64| {
        let phase = (t_s - t0) / length_s;
        let within = phase.fract() * length_s;
        (MARGIN_S..=length_s - MARGIN_S).contains(&within).then_some(phase.floor() as usize % 2)
    };
    log.bins.iter().map(|b| of(b.t_s)).collect()
}

type Residuals = [Vec<Vector3<f64>>; 4];

fn predicted(
    log: &Observed,
    model: &Model<'_>,
    point: &Point,
    tangent: &Tangent,
    bounds: &[Bound],
    folds: &[Option<usize>],
) -> (Residuals, Vec<f64>) {
    let parts = tangent.parts(point, log.bins.len(), 2, |k| folds[k]);
    let mut residual: Residuals = std::array::from_fn(|_| vec![Vector3::zeros(); log.bins.len()]);
    for fold in 0..2 {
        let mask: Vec<f64> = folds.iter().map(|f| if *f == Some(1 - fold) { 1.0 } else { 0.0 }).collect();
        let mut sums = parts[1 - fold].clone();
        sums.add_prior(point, bounds);
        let s = refitted(log, model, point, bounds, &sums, &mask);
        for (k, _) in folds.iter().enumerate().filter(|(_, f)| **f == Some(fold)) {
            for (all, these) in residual.iter_mut().zip(&s.residual) {
                all[k] = these[k];
            }
        }
    }
    (residual, folds.iter().map(|f| if f.is_some() { 1.0 } else { 0.0 }).collect())
}

/// The fit without a fold: the step along the tangent, shortened until it does what it promises.
fn refitted(log: &Observed, model: &Model<'_>, point: &Point, bounds: &[Bound], sums: &Sums, mask: &[f64]) -> Scored {
    let cost = |s: &Scored, theta: &[f64]| {
        let data: f64 = (0..4)
            .map(|kind| {
                let of = |(k, b): (usize, &crate::diagnosis::observe::Bin)| {
                    s.residual[kind][k].norm_squared() * (b.weight[kind] * mask[k]).powi(2)
                };
                log.bins.iter().enumerate().map(of).sum::<f64>()
            })
            .sum();
        data + Point::prior_of(theta, bounds)
    };
    let still = sense(log, model, &point.theta, &point.motion, mask);
    let before = cost(&still, &point.theta);
    let Some(mut theta) = step(&point.theta, bounds, sums, 1e-4) else { return still };
    for _ in 0..3 {
        let s = sense(log, model, &theta, &run(log, model, &theta), mask);
        if cost(&s, &theta) <= before {
            return s;
        }
        theta.iter_mut().zip(&point.theta).for_each(|(t, p)| *t = p + (*t - p) * 0.3);
    }
    still
}

/// RMSE per kind and energy per block of weighted residuals.
#[must_use]
pub fn score(log: &Observed, residual: Residuals, used: &[f64]) -> HeldOut {
    let count = (log.duration_s() / BLOCKS_S[0]).ceil() as usize + 1;
    let mut sums = vec![[(0.0, 0.0); 4]; count];
    for (k, bin) in log.bins.iter().enumerate() {
        let at = ((bin.t_s - log.start_s()) / BLOCKS_S[0]) as usize;
        for kind in 0..4 {
            let w = bin.weight[kind].powi(2) * used[k];
            let s = &mut sums[at.min(count - 1)][kind];
            *s = (s.0 + w * residual[kind][k].norm_squared(), s.1 + w);
        }
    }
    let total: [f64; 4] = std::array::from_fn(|kind| sums.iter().map(|b| b[kind].1).sum::<f64>());
    let square = 1f64.to_degrees().powi(2);
    let rmse_deg = std::array::from_fn(|kind| {
        let e: f64 = sums.iter().map(|b| b[kind].0).sum();
        if total[kind] > 0.0 { (e / total[kind] * square).sqrt() } else { 0.0 }
    });
    let blocks = sums.iter().map(|b| (0..4).filter(|&k| total[k] > 0.0).map(|k| b[k].0 / total[k] * square).sum()).collect();
    HeldOut { rmse_deg, blocks, residual }
}
