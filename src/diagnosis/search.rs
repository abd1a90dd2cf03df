//! Which set of effects explains the log: every single effect, then pairs grown from the best.
//!
//! Every single effect is fitted to the whole log from its most promising start and scored on left-out blocks. The best
//! few are extended by every other effect; the tangent selects the pairs worth a fit. [`crate::diagnosis::decide`]
//! checks whether a pair needs both members.

use crate::diagnosis::chain::Model;
use crate::diagnosis::fit::{Fitted, fit};
use crate::diagnosis::holdout::{CLAIM_DEG, HeldOut, leave_out};
use crate::diagnosis::observe::{CORRELATED_S, Observed};
use crate::diagnosis::problem::{Point, Problem};
use crate::diagnosis::start::{Start, best_start, dated_again};
use crate::diagnosis::tangent::{BaseFit, Tangent};
use crate::model::effects::Effect;
use crate::model::{Line, nominal_theta};
use rayon::prelude::*;

/// Rounds of a fit.
const ROUNDS: usize = 8;
/// Pairs that are fitted from each of the best singles.
const GROWN: [usize; 3] = [9, 4, 3];
/// Most rounds in which events are dated again after a fit, for a single effect and for a pair: the first of a pair has been dated.
const DATED: [usize; 2] = [4, 1];
/// A fit with events dated again is kept if it leaves less than this part of the cost.
const DATED_GAIN: f64 = 0.99;

/// A set of effects with its fit and its scores.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Names, in catalogue order.
    pub names: Vec<&'static str>,
    /// Fit to the whole log.
    pub fitted: Fitted,
    /// Held-out scores.
    pub held_out: HeldOut,
    /// Sum over the effects of [`Effect::unusual`].
    pub unusual: f64,
}

impl Candidate {
    /// The candidate of a fit.
    pub fn new(fit: &BaseFit<'_>) -> Self {
        let BaseFit { problem, point, tangent } = fit;
        Self {
            names: problem.model.names(),
            fitted: Fitted::new(problem, point, tangent),
            held_out: leave_out(problem, point, tangent),
            unusual: problem.model.each(&point.theta).map(|(e, p)| e.unusual(p)).sum(),
        }
    }

    /// Held-out energy, deg².
    pub fn energy(&self) -> f64 {
        self.held_out.energy()
    }
}

/// All candidates of a search.
#[derive(Debug, Clone)]
pub struct Candidates {
    /// The nominal model.
    pub nominal: Candidate,
    /// Every single effect, best first.
    pub singles: Vec<Candidate>,
    /// Fitted pairs, best first.
    pub pairs: Vec<Candidate>,
}

impl Candidates {
    /// All candidates: singles, pairs, nominal.
    pub fn all(&self) -> impl Iterator<Item = &Candidate> {
        self.singles.iter().chain(&self.pairs).chain([&self.nominal])
    }

    /// The candidate of a single effect.
    pub fn single(&self, name: &str) -> Option<&Candidate> {
        self.singles.iter().find(|s| s.names[0] == name)
    }

    /// The gap that recalibration leaves above noise, deg².
    pub fn gap(&self, log: &Observed) -> f64 {
        (self.nominal.energy() - log.noise_energy()).max(1e-9)
    }
}

/// Runs the search; `lines` is the start of the recalibration.
pub fn search(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3]) -> Candidates {
    let start = nominal_theta(lines, log.rig.prior_lag_s);
    let (nominal, base) = settle(Problem::new(log, Model::new(&[])), &start);
    let single = |e: &dyn Effect| {
        let to = Problem::new(log, Model::new(&[e]));
        let start = best_start(&base, &to, e).map_or_else(|| base.point.theta.clone(), |s| s.theta);
        settle(to, &start).0
    };
    let mut singles: Vec<Candidate> = catalogue.par_iter().map(|e| single(e.as_ref())).collect();
    sort_by_energy(&mut singles);
    let mut pairs = Vec::new();
    let wanted = singles.first().map_or([0; 3], |best| grown(log, &nominal.held_out, &best.held_out));
    for (seed, wanted) in singles.iter().zip(wanted).filter(|(_, wanted)| *wanted > 0) {
        let known: Vec<Vec<&str>> = pairs.iter().map(|p: &Candidate| p.names.clone()).collect();
        pairs.extend(grow(log, catalogue, seed, wanted, &known));
    }
    sort_by_energy(&mut pairs);
    Candidates { nominal, singles, pairs }
}

/// The recalibrated nominal model; `lines` is its start.
pub fn recalibrated(log: &Observed, lines: &[Line; 3]) -> Candidate {
    settle(Problem::new(log, Model::new(&[])), &nominal_theta(lines, log.rig.prior_lag_s)).0
}

/// How many pairs are grown from each of the best singles: none where no two effects could be claimed, and half as many where the
/// best single leaves less than can be claimed, because a single that is not in the log can stand for two that are.
fn grown(log: &Observed, nominal: &HeldOut, best: &HeldOut) -> [usize; 3] {
    let leaves = |h: &HeldOut| log.quantities().map(|q| h.rmse_deg[q] - 3f64.sqrt() * log.noise_deg[q]).fold(0.0, f64::max);
    match leaves(best) {
        _ if leaves(nominal) < CLAIM_DEG => [0; 3],
        left if left > CLAIM_DEG => GROWN,
        left if left > CLAIM_DEG / 2.0 => GROWN.map(|n| n.div_ceil(2)),
        _ => [0; 3],
    }
}

fn sort_by_energy(list: &mut [Candidate]) {
    list.sort_by(|a, b| a.energy().total_cmp(&b.energy()));
}

/// Fits a problem until it converges, and scores it.
fn settle<'a>(problem: Problem<'a>, start: &[f64]) -> (Candidate, BaseFit<'a>) {
    let (mut point, mut tangent) = fit(&problem, start, ROUNDS);
    let pair = problem.model.effects.len() > 1;
    for _ in 0..DATED[usize::from(pair)] {
        let again = |slow_too: bool| dated_again(&problem, &point, slow_too).map(|dated| fit(&problem, &dated, ROUNDS));
        let better = |(p, _): &(Point, Tangent)| p.data() < DATED_GAIN * point.data();
        let Some(next) = again(false).filter(better).or_else(|| (!pair).then(|| again(true))?.filter(better)) else { break };
        (point, tangent) = next;
    }
    let base = BaseFit { problem, point, tangent };
    (Candidate::new(&base), base)
}

/// The most promising pairs of a single with another effect by Schwarz's criterion, except the `known` ones.
fn grow(log: &Observed, catalogue: &[Box<dyn Effect>], seed: &Candidate, wanted: usize, known: &[Vec<&str>]) -> Vec<Candidate> {
    let (_, base) = settle(Problem::new(log, Model::named(catalogue, &seed.names)), &seed.fitted.theta);
    let pair = |e: &dyn Effect| Problem::new(log, Model::named(catalogue, &[seed.names[0], e.name()]));
    let fresh = |e: &dyn Effect| {
        let names = pair(e).model.names();
        names.len() == 2 && !known.contains(&names)
    };
    let mut promising: Vec<_> = catalogue
        .par_iter()
        .filter(|e| fresh(e.as_ref()))
        .filter_map(|e| best_start(&base, &pair(e.as_ref()), e.as_ref()).map(|s| (e, s)))
        .collect();
    let independent = log.duration_s() / CORRELATED_S * 3.0 * log.quantities().count() as f64;
    let criterion = |e: &dyn Effect, s: &Start| independent * s.predicted.ln() + e.params().len() as f64 * independent.ln();
    promising.sort_by(|a, b| criterion(a.0.as_ref(), &a.1).total_cmp(&criterion(b.0.as_ref(), &b.1)));
    promising.truncate(wanted);
    promising.par_iter().map(|(e, s)| settle(pair(e.as_ref()), &s.theta).0).collect()
}
