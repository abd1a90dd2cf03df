//! The sets of effects that are fitted to the log of a tip.
//!
//! Every single effect is fitted to the whole log from its most promising start and scored on left-out blocks. Pairs that are worth a fit
//! are those that extend the best single, by the tangent there, and the best of all pairs by the normal matrix of all singles
//! ([`mod@crate::diagnosis::tip::fit::screen`]).

use crate::diagnosis::tip::fit::{
    Alone, BaseFit, CLAIM_DEG, Candidate, HeldOut, LeastSquares, Start, Tangent, alone, best_start,
    dated_again, fit, grown, schwarz, screen,
};
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::{Candidates, Search};
use crate::model::effects::Effect;
use crate::model::{Line, Model, nominal_theta};
use rayon::prelude::*;

/// Rounds of a fit.
const ROUNDS: usize = 8;
/// Sets that are fitted: pairs that extend the best single, the best of all pairs, triples that extend the best pair.
const FITTED: [usize; 3] = [4, 8, 3];
/// Most rounds in which events are dated again after a fit, for a single effect and for a larger set: the first of a pair has been dated.
const DATED: [usize; 2] = [4, 1];
/// A fit with events dated again is kept if it leaves less than this part of the cost.
const DATED_GAIN: f64 = 0.99;

/// The log of a tip, and the catalogue that may explain it.
pub struct TipProblem<'a> {
    /// The log.
    pub log: &'a Observed,
    /// The effects.
    pub catalogue: &'a [&'static dyn Effect],
    /// The calibration that the log was driven with, from which the recalibration starts.
    pub lines: &'a [Line; 3],
    /// Seed of the bootstrap.
    pub seed: u64,
    /// The recalibrated nominal model.
    pub nominal: Candidate,
    base: BaseFit<'a>,
}

impl<'a> TipProblem<'a> {
    /// The problem of a log that was driven with the calibration `lines`; `seed` is that of the bootstrap.
    pub fn new(
        log: &'a Observed,
        catalogue: &'a [&'static dyn Effect],
        lines: &'a [Line; 3],
        seed: u64,
    ) -> Self {
        let base = recalibration(log, lines);
        Self {
            log,
            catalogue,
            lines,
            seed,
            nominal: Candidate::new(&base),
            base,
        }
    }

    /// The fits of sets of effects, each from a start of its own.
    fn fitted(&self, sets: Vec<(Model, Vec<f64>)>) -> Vec<Candidate> {
        let problem = |model| LeastSquares::new(self.log, model);
        let sets = sets.into_par_iter();
        sets.map(|(model, start)| Candidate::new(&settle(problem(model), &start)))
            .collect()
    }

    /// The most that a sensor's RMSE is above its noise, degrees or °/s.
    fn leaves(&self, h: &HeldOut) -> f64 {
        let above = |q| h.rmse_deg[q] - 3f64.sqrt() * self.log.noise_deg[q];
        self.log.quantities().map(above).fold(0.0, f64::max)
    }

    /// The most promising extensions of a set by one effect, by Schwarz's criterion.
    fn extensions(&self, set: &Candidate, wanted: usize) -> Vec<Candidate> {
        let problem = LeastSquares::new(self.log, set.model.clone());
        let base = settle(problem, &set.theta);
        let criterion = |(model, s): &(Model, Start)| {
            let before = base.problem.model.present(&base.point.theta);
            schwarz(self.log, s.predicted, model.present(&s.theta) - before)
        };
        let mut sets = grown(&base, self.catalogue);
        sets.sort_by(|a, b| criterion(a).total_cmp(&criterion(b)));
        let sets = sets.into_iter().take(wanted);
        self.fitted(sets.map(|(model, s)| (model, s.theta)).collect())
    }
}

impl Search for TipProblem<'_> {
    type Set = Candidate;
    type Trace = Tangent;

    fn nominal(&self) -> &Candidate {
        &self.nominal
    }

    fn singles(&self) -> Vec<Alone> {
        let single = |e: &&'static dyn Effect| {
            let (base, to) = (&self.base, LeastSquares::new(self.log, Model::new(&[*e])));
            let start = best_start(base, &to, *e).map(|s| s.theta);
            let start = start.as_ref().unwrap_or(&base.point.theta);
            alone(base, settle(to, start))
        };
        self.catalogue.par_iter().map(single).collect()
    }

    /// The pairs that are worth a fit: none where no two effects could be claimed, and half as many where the best single leaves less than
    /// can be claimed, because a single that is not in the log can stand for two that are.
    fn pairs(&self, alone: &[Alone]) -> Vec<Candidate> {
        let Some((best, _)) = alone.first() else {
            return vec![];
        };
        let [extended, screened, _] = match self.leaves(&best.held_out) {
            _ if self.leaves(&self.nominal.held_out) < CLAIM_DEG => return vec![],
            left if left > CLAIM_DEG => FITTED,
            left if left > CLAIM_DEG / 2.0 => FITTED.map(|n| n / 2),
            _ => return vec![],
        };
        let mut out = self.extensions(best, extended);
        let mut screen = screen(&self.base, self.catalogue, alone);
        screen.retain(|(model, _)| out.iter().all(|c| c.model != *model));
        screen.truncate(screened);
        out.extend(self.fitted(screen));
        out
    }

    /// The triples that are worth a fit: none where the best pair leaves less than can be claimed.
    fn triples(&self, pair: &Candidate) -> Vec<Candidate> {
        let leaves = self.leaves(&pair.held_out) > CLAIM_DEG;
        let further = leaves.then(|| self.extensions(pair, FITTED[2]));
        further.unwrap_or_default()
    }

    /// The pairs in these triples that have not been fitted.
    fn parts(&self, found: &Candidates<Candidate>, triples: &[Candidate]) -> Vec<Candidate> {
        let mut missing: Vec<(Model, Vec<f64>)> = Vec::new();
        for triple in triples {
            for left_out in &triple.names {
                let mut effects = triple.model.effects.clone();
                effects.retain(|e| e.name() != *left_out);
                let part = Model::new(&effects);
                let unknown = missing.iter().all(|(known, _)| *known != part);
                if unknown && found.without(triple, left_out).is_none() {
                    let start = part.extended(&triple.model, &triple.theta, |_| vec![]);
                    missing.push((part, start));
                }
            }
        }
        self.fitted(missing)
    }
}

/// The recalibrated nominal model of a log that was driven with the calibration `lines`.
pub fn recalibrated(log: &Observed, lines: &[Line; 3]) -> Candidate {
    Candidate::new(&recalibration(log, lines))
}

fn recalibration<'a>(log: &'a Observed, lines: &[Line; 3]) -> BaseFit<'a> {
    let start = nominal_theta(lines, log.rig.prior_lag_s);
    settle(LeastSquares::new(log, Model::new(&[])), &start)
}

/// Fits a problem until it converges.
fn settle<'a>(problem: LeastSquares<'a>, start: &[f64]) -> BaseFit<'a> {
    let mut best = fit(problem, start, ROUNDS);
    let several = best.problem.model.effects.len() > 1;
    for _ in 0..DATED[usize::from(several)] {
        let again = |slow_too: bool| {
            let next = fit(best.problem.clone(), &dated_again(&best, slow_too)?, ROUNDS);
            Some(next).filter(|next| next.point.data() < DATED_GAIN * best.point.data())
        };
        match again(false).or_else(|| (!several).then(|| again(true))?) {
            Some(next) => best = next,
            None => break,
        }
    }
    best
}
