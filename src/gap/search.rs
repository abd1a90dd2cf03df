//! Which set of effects explains the log: every single one, then pairs grown from the best, scored on
//! blocks that the fit has not seen.
//!
//! All singles are fitted on the whole log from each of their starting points. The best few are grown
//! by every other effect (forward), and a grown set is kept only if each member is needed (backward).
//! What is compared is not the fit but the prediction: contiguous blocks are left out in turn, the
//! model runs through the whole log from the pistons alone, and the left-out blocks are scored.
//! Effects that happen once have no gradient to their own time; a scan over the log finds it.

use crate::effects::Effect;
use crate::gap::chain::{Model, run};
use crate::gap::decide::CLAIM_DEG;
use crate::gap::fit::{Fitted, Scored, extend, fit, nominal_start, sense};
use crate::gap::observe::Observed;
use crate::model::transmission::Line;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Length of a left-out block, s.
const BLOCK_S: f64 = 12.0;
/// Gap on either side of a left-out block that is neither fitted nor scored, s.
const MARGIN_S: f64 = 0.3;
/// Rounds of a first, rough fit and of a final one.
const ROUGH: usize = 3;
const FINE: usize = 8;
/// Candidates of a list that are fitted to the end.
const REFINED: usize = 8;
/// Singles that are grown to pairs.
const BEAM: usize = 2;
/// Pairs that are scored on left-out blocks; singles all are.
const FINALISTS: usize = 5;

/// A set of effects with its fit and its scores.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Names, in catalogue order.
    pub names: Vec<&'static str>,
    /// Fit on the whole log.
    pub fitted: Fitted,
    /// Held-out scores, once computed.
    pub held_out: Option<HeldOut>,
}

/// Held-out residual energies.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// RMSE per kind over the left-out blocks, degrees (°/s for the gyroscope); 0 where missing.
    pub rmse_deg: [f64; 4],
    /// Energy per block, summed over kinds, deg², with the block's bin count.
    pub blocks: Vec<f64>,
    /// Residuals of every bin as predicted when its block was left out.
    pub residual: [Vec<Vector3<f64>>; 4],
}

impl HeldOut {
    /// Energy over all kinds, deg².
    #[must_use]
    pub fn energy(&self) -> f64 {
        self.rmse_deg.iter().map(|e| e * e).sum()
    }
}

/// Everything the search found.
#[derive(Debug, Clone)]
pub struct Found {
    /// The nominal model.
    pub nominal: Candidate,
    /// Every single effect, best first.
    pub singles: Vec<Candidate>,
    /// Pairs that were grown, best first.
    pub pairs: Vec<Candidate>,
}

/// Runs the search. `progress` is called with the fraction done.
#[must_use]
pub fn search(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3]) -> Found {
    let all = vec![1.0; log.bins.len()];
    let none = Model::new(&[]);
    let base = fit(log, &none, &nominal_start(lines), &all, FINE);
    let mut nominal = Candidate { names: vec![], fitted: base.clone(), held_out: None };
    nominal.held_out = Some(leave_out(log, catalogue, &nominal));
    let mut singles: Vec<Candidate> = catalogue
        .par_iter()
        .map(|e| {
            let model = Model::new(&[e.as_ref()]);
            let fitted = grow(log, &none, &base.theta, &model, e.as_ref(), &all);
            Candidate { names: vec![e.name()], fitted, held_out: None }
        })
        .collect();
    refine(log, catalogue, &mut singles, &all);
    hold_out(log, catalogue, &mut singles, usize::MAX);
    singles.sort_by(|a, b| energy(a).total_cmp(&energy(b)));
    let mut pairs = Vec::new();
    if singles.first().and_then(|s| s.held_out.as_ref()).is_some_and(|h| room(log, h)) {
        pairs = grow_pairs(log, catalogue, &singles, &all);
        refine(log, catalogue, &mut pairs, &all);
        hold_out(log, catalogue, &mut pairs, FINALISTS);
    }
    Found { nominal, singles, pairs }
}

/// Whether a further effect could gain what is worth a claim at all.
fn room(log: &Observed, h: &HeldOut) -> bool {
    (0..4).any(|k| h.rmse_deg[k] - 3f64.sqrt() * log.noise_deg[k] > CLAIM_DEG)
}

fn energy(c: &Candidate) -> f64 {
    c.held_out.as_ref().map_or(f64::INFINITY, HeldOut::energy)
}

/// Fits the best of a rough list to the end.
fn refine(log: &Observed, catalogue: &[Box<dyn Effect>], list: &mut [Candidate], all: &[f64]) {
    by_cost(list);
    let n = list.len().min(REFINED);
    list[..n].par_iter_mut().for_each(|c| c.fitted = fit(log, &model_of(catalogue, &c.names), &c.fitted.theta, all, FINE));
    by_cost(list);
}

fn hold_out(log: &Observed, catalogue: &[Box<dyn Effect>], list: &mut [Candidate], most: usize) {
    let n = list.len().min(most);
    list[..n].par_iter_mut().for_each(|c| c.held_out = Some(leave_out(log, catalogue, c)));
}

fn by_cost(list: &mut [Candidate]) {
    list.sort_by(|a, b| a.fitted.cost.total_cmp(&b.fitted.cost));
}

/// Effects of a candidate, in catalogue order.
#[must_use]
pub fn model_of<'a>(catalogue: &'a [Box<dyn Effect>], names: &[&str]) -> Model<'a> {
    let effects: Vec<&dyn Effect> = catalogue.iter().map(AsRef::as_ref).filter(|e| names.contains(&e.name())).collect();
    Model::new(&effects)
}

fn grow_pairs(log: &Observed, catalogue: &[Box<dyn Effect>], singles: &[Candidate], all: &[f64]) -> Vec<Candidate> {
    let seeds = &singles[..singles.len().min(BEAM)];
    let tasks: Vec<(&Candidate, &dyn Effect)> =
        seeds.iter().flat_map(|s| catalogue.iter().map(move |e| (s, e.as_ref()))).filter(|(s, e)| s.names[0] != e.name()).collect();
    let mut pairs: Vec<Candidate> = tasks
        .par_iter()
        .map(|(seed, e)| {
            let from = model_of(catalogue, &seed.names);
            let mut names = [seed.names[0], e.name()];
            let to = model_of(catalogue, &names);
            names = [to.effects[0].name(), to.effects[1].name()];
            let fitted = grow(log, &from, &seed.fitted.theta, &to, *e, all);
            Candidate { names: names.to_vec(), fitted, held_out: None }
        })
        .collect();
    by_cost(&mut pairs);
    let mut seen: Vec<Vec<&str>> = Vec::new();
    pairs.retain(|p| {
        let new = !seen.contains(&p.names);
        seen.push(p.names.clone());
        new
    });
    pairs
}

/// Fits `to`, which has one effect more than `from`, roughly, from each of that effect's starting
/// points: a step or two from all of them, more from the best.
fn grow(log: &Observed, from: &Model<'_>, theta: &[f64], to: &Model<'_>, added: &dyn Effect, mask: &[f64]) -> Fitted {
    let mut starts = added.starts();
    if let Some(found) = scan(log, from, theta, to, added, mask) {
        starts = vec![found];
    }
    let first = |start: &Vec<f64>| fit(log, to, &extend(from, theta, to, start), mask, if starts.len() > 1 { 2 } else { ROUGH });
    let best = starts.iter().map(first).min_by(|a, b| a.cost.total_cmp(&b.cost));
    best.unwrap_or_else(|| fit(log, to, &extend(from, theta, to, &[]), mask, ROUGH))
}

/// For an effect that happens once: the time and the three offsets that explain most of what is left,
/// by least squares over all times at once (prefix sums of the sensitivity to an early event).
fn scan(log: &Observed, from: &Model<'_>, theta: &[f64], to: &Model<'_>, added: &dyn Effect, mask: &[f64]) -> Option<Vec<f64>> {
    let params = added.params();
    let time = params.iter().position(|p| p.name == "t1_s")?;
    let offsets: Vec<usize> = (0..params.len()).filter(|&i| params[i].name.starts_with("d1")).collect();
    let [a, b, c] = offsets[..] else { return None };
    let residuals = |fresh: &[f64]| {
        let full = extend(from, theta, to, fresh);
        weighted(log, &sense(log, to, &full, &run(log, to, &full), mask))
    };
    let mut early: Vec<f64> = params.iter().map(|p| p.start).collect();
    early[time] = 0.5;
    let r0 = residuals(&early);
    let columns: Vec<Vec<[f64; 12]>> = [a, b, c]
        .iter()
        .map(|&i| {
            let mut moved = early.clone();
            moved[i] += params[i].scale;
            residuals(&moved).iter().zip(&r0).map(|(x, y)| std::array::from_fn(|k| (x[k] - y[k]) / params[i].scale)).collect()
        })
        .collect();
    let (mut n, mut s) = (Matrix3::zeros(), Vector3::zeros());
    let mut best = (0.0, 0, Vector3::zeros());
    for k in (1..log.bins.len()).rev() {
        for i in 0..12 {
            let d = Vector3::new(columns[0][k][i], columns[1][k][i], columns[2][k][i]);
            n += d * d.transpose();
            s += d * r0[k][i];
        }
        let Some(x) = (n + Matrix3::identity() * 1e-6).try_inverse().map(|inv| inv * s) else { continue };
        let gain = s.dot(&x);
        if gain > best.0 {
            best = (gain, k, -x);
        }
    }
    let mut out: Vec<f64> = params.iter().map(|p| p.start).collect();
    out[time] = log.bins[best.1].t_s - log.t_s[0];
    for (&i, v) in [a, b, c].iter().zip(best.2.iter()) {
        out[i] = v.clamp(params[i].low, params[i].high);
    }
    Some(out)
}

fn weighted(log: &Observed, s: &Scored) -> Vec<[f64; 12]> {
    (0..log.bins.len()).map(|k| std::array::from_fn(|i| s.residual[i / 3][k][i % 3] * log.bins[k].weight[i / 3])).collect()
}

/// Which fold each bin is left out in (0 or 1), and whether it is too near the other fold to be used.
fn folds(log: &Observed) -> Vec<(usize, bool)> {
    let t0 = log.t_s[0];
    log.bins
        .iter()
        .map(|b| {
            let phase = (b.t_s - t0) / BLOCK_S;
            let within = phase.fract() * BLOCK_S;
            ((phase.floor() as usize) % 2, !(MARGIN_S..=BLOCK_S - MARGIN_S).contains(&within))
        })
        .collect()
}

/// Leaves the blocks of each fold out in turn, refits from the full fit, and scores what was left out.
#[must_use]
pub fn leave_out(log: &Observed, catalogue: &[Box<dyn Effect>], candidate: &Candidate) -> HeldOut {
    let model = model_of(catalogue, &candidate.names);
    let folds = folds(log);
    let mut residual: [Vec<Vector3<f64>>; 4] = std::array::from_fn(|_| vec![Vector3::zeros(); log.bins.len()]);
    let mut used = vec![0.0; log.bins.len()];
    for fold in 0..2 {
        let mask: Vec<f64> = folds.iter().map(|(f, near)| if *f == fold || *near { 0.0 } else { 1.0 }).collect();
        let f = fit(log, &model, &candidate.fitted.theta, &mask, ROUGH);
        let s = sense(log, &model, &f.theta, &run(log, &model, &f.theta), &mask);
        for (k, (of, near)) in folds.iter().enumerate() {
            if *of == fold && !near {
                used[k] = 1.0;
                for (all, these) in residual.iter_mut().zip(&s.residual) {
                    all[k] = these[k];
                }
            }
        }
    }
    score(log, residual, &used)
}

/// RMSE per kind and energy per block of weighted residuals.
#[must_use]
pub fn score(log: &Observed, residual: [Vec<Vector3<f64>>; 4], used: &[f64]) -> HeldOut {
    let blocks = (log.duration_s() / BLOCK_S).ceil() as usize + 1;
    let mut sums = vec![[(0.0, 0.0); 4]; blocks];
    for (k, bin) in log.bins.iter().enumerate() {
        let at = ((bin.t_s - log.t_s[0]) / BLOCK_S) as usize;
        for kind in 0..4 {
            let w = bin.weight[kind].powi(2) * used[k];
            let s = &mut sums[at.min(blocks - 1)][kind];
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
