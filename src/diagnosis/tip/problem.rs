//! A tip as a problem: the sets of effects that are fitted to its log, and the features of the statements about it.
//!
//! Every single effect is fitted to the whole log from its most promising start and scored on left-out blocks. Pairs that are worth a fit
//! are those that extend the best single, by the tangent there, and the best of all pairs by the normal matrix of all singles
//! ([`mod@crate::diagnosis::tip::fit::screen`]). The density of a block and sensor is that of residuals whose variance is unknown
//! ([`crate::diagnosis::tip::fit::holdout::density`]).

use crate::diagnosis::tip::alike;
use crate::diagnosis::tip::fit::{
    Alone, BaseFit, CLAIM_DEG, Candidate, HeldOut, LeastSquares, Start, alone, best_start,
    dated_again, fit, grown, schwarz, screen,
};
use crate::diagnosis::tip::observed::{Observed, Quantity, dependences};
use crate::diagnosis::verdict::{Claim, Feature, Head};
use crate::diagnosis::{Candidates, Problem, Scored};
use crate::model::effects::Effect;
use crate::model::{Line, Model, nominal_theta};
use rayon::prelude::*;
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.15;
/// Part of the least claimed error, which an effect brings to a recalibrated model, that the effect must explain beyond the others of its
/// set. The labels of the training logs hold that error itself, so the weights know it; a law of another form explains a part of it, and the
/// other effects, fitted again without it, take over another part.
const SHOWN: f64 = 2.0 / 3.0;

/// The weights that diagnoses use.
static HEAD: LazyLock<Head> = LazyLock::new(|| Head::built_in(include_str!("posterior.toml")));

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

    /// Mean density of the short blocks.
    fn short(&self, set: &Candidate) -> f64 {
        self.log.mean(&set.held_out.density[1])
    }

    /// Logarithm of the largest RMS of a sensor above the noise, degrees or °/s.
    fn worst(&self, set: &Candidate) -> f64 {
        let square = |q| set.held_out.rmse_deg[q].powi(2) - 3.0 * self.log.noise_deg[q].powi(2);
        let roots = self.log.quantities().map(|q| square(q).max(0.0).sqrt());
        roots.fold(0.05, f64::max).ln()
    }
}

impl Problem for TipProblem<'_> {
    type Set = Candidate;

    fn nominal(&self) -> &Candidate {
        &self.nominal
    }

    fn singles_and_pairs(&self) -> [Vec<Candidate>; 2] {
        let single = |e: &&'static dyn Effect| {
            let (base, to) = (&self.base, LeastSquares::new(self.log, Model::new(&[*e])));
            let start = best_start(base, &to, *e).map(|s| s.theta);
            let start = start.as_ref().unwrap_or(&base.point.theta);
            alone(base, settle(to, start))
        };
        let mut all: Vec<Alone> = self.catalogue.par_iter().map(single).collect();
        all.sort_by(|a, b| a.0.energy().total_cmp(&b.0.energy()));
        let pairs = self.pairs(&all);
        [all.into_iter().map(|(set, _)| set).collect(), pairs]
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

    fn head() -> &'static Head {
        &HEAD
    }
    fn lack(&self, set: &Candidate) -> f64 {
        let long = self.log.mean(&set.held_out.density[0]);
        long + self.short(set) + 2.0 * PER_EFFECT * set.names.len() as f64
    }
    /// Of the short blocks: mean over the sensors, and gyroscope.
    fn density(&self, set: &Candidate) -> Vec<Feature> {
        let gyro = if self.log.has[Quantity::Gyro] {
            -set.held_out.density[1][Quantity::Gyro]
        } else {
            0.0
        };
        vec![("density", -self.short(set)), ("density_gyro", gyro)]
    }
    fn of_set(&self, found: &Candidates<Candidate>, set: &Candidate) -> Vec<Feature> {
        let information = (set.information - self.nominal.information) / 10.0;
        let [claim, second_claim] = found.claims(set);
        vec![
            ("further_effects", set.names.len() as f64 - 1.0),
            // what the log tells about the parameters
            ("information", information),
            ("claim", claim),
            ("second_claim", second_claim),
            // part of the parameters that no usual form of the cause has
            ("unusual", set.unusual),
        ]
    }
    fn of_none(&self) -> Vec<Feature> {
        vec![("none_worst", self.worst(&self.nominal))]
    }
    fn of_unknown(&self, found: &Candidates<Candidate>, best: &Candidate) -> Vec<Feature> {
        let nominal = self.short(&self.nominal);
        let depends = dependences(self.log, &best.held_out.residual);
        let singles = found.singles.iter().map(|s| self.short(s));
        let single = singles.fold(f64::INFINITY, f64::min);
        vec![
            ("unknown_worst", self.worst(best)),
            // the density of the long blocks of the best set, and of the short blocks with the nominal model
            ("unknown_best", self.log.mean(&best.held_out.density[0])),
            ("unknown_nominal", nominal),
            // largest part of what a sensor leaves that some dependence predicts
            (
                "unknown_share",
                depends.iter().map(|d| d.share).fold(0.0, f64::max),
            ),
            // what the best set gains over the best single effect: several effects together imitate many a law
            ("unknown_single", self.short(best) - single.min(nominal)),
        ]
    }
    fn claim(&self, found: &Candidates<Candidate>, set: &Candidate) -> Claim {
        // what is below the bar counts as `none`
        let shown = found.claimable(set, &|set, part| set.gain(part) >= SHOWN);
        Claim::of(shown.names.clone())
    }

    fn alike(&self) -> Vec<[&'static str; 2]> {
        alike(self.log.has[Quantity::Reference])
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        assert!(HEAD.weight["density"] > 0.0 && (0.5..1.0).contains(&HEAD.conformal));
    }
}
