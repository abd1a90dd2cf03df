//! Which set of effects explains the log: every single effect, the pairs that may explain more, and triples where a pair leaves something.
//!
//! Every single effect is fitted to the whole log from its most promising start and scored on left-out blocks. Pairs that are worth a fit
//! are those that extend the best single, by the tangent there, and the best of all pairs by the normal matrix of all singles
//! ([`crate::diagnosis::tip::fit::screen`]). [`crate::diagnosis::verdict::decide`] checks whether a set needs all its members.

use crate::diagnosis::candidates::{Candidates, Scored, sort_by_energy};
use crate::diagnosis::tip::fit::candidate::Candidate;
use crate::diagnosis::tip::fit::fit;
use crate::diagnosis::tip::fit::holdout::{CLAIM_DEG, HeldOut};
use crate::diagnosis::tip::fit::least_squares::{Point, Problem};
use crate::diagnosis::tip::fit::screen::{Alone, schwarz, screen};
use crate::diagnosis::tip::fit::start::{Start, best_start, dated_again};
use crate::diagnosis::tip::fit::tangent::{BaseFit, Tangent};
use crate::diagnosis::tip::model::chain::Model;
use crate::diagnosis::tip::observed::Observed;
use crate::model::effects::Effect;
use crate::model::{Line, nominal_theta};
use rayon::prelude::*;

/// Rounds of a fit.
const ROUNDS: usize = 8;
/// Sets that are fitted: pairs that extend the best single, the best of all pairs, triples that extend the best pair.
const FITTED: [usize; 3] = [4, 8, 3];
/// Most rounds in which events are dated again after a fit, for a single effect and for a larger set: the first of a pair has been dated.
const DATED: [usize; 2] = [4, 1];
/// A fit with events dated again is kept if it leaves less than this part of the cost.
const DATED_GAIN: f64 = 0.99;

/// Runs the search; `lines` is the start of the recalibration.
pub fn search(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    lines: &[Line; 3],
) -> Candidates<Candidate> {
    let base = settle(
        Problem::new(log, Model::new(&[])),
        &nominal_theta(lines, log.rig.prior_lag_s),
    );
    let nominal = Candidate::new(&base);
    let single = |e: &dyn Effect| {
        let to = Problem::new(log, Model::new(&[e]));
        let start = best_start(&base, &to, e).map_or_else(|| base.point.theta.clone(), |s| s.theta);
        Alone::new(&base, settle(to, &start))
    };
    let mut alone: Vec<Alone> = catalogue.par_iter().map(|e| single(e.as_ref())).collect();
    alone.sort_by(|a, b| a.candidate.energy().total_cmp(&b.candidate.energy()));
    let wanted = alone.first().map_or([0; 2], |best| {
        pairs(log, &nominal.held_out, &best.candidate.held_out)
    });
    let mut found = Candidates {
        nominal,
        singles: vec![],
        larger: vec![],
    };
    if wanted[0] > 0 {
        found.larger = grow(log, catalogue, &alone[0].candidate, wanted[0]);
        let known = |names: &[&str]| found.larger.iter().any(|c| c.names == names);
        let screened: Vec<_> = screen(&base, catalogue, &alone)
            .into_iter()
            .filter(|(names, _)| !known(names))
            .take(wanted[1])
            .collect();
        found.larger.par_extend(
            screened
                .par_iter()
                .map(|(names, theta)| fitted(log, catalogue, names, theta)),
        );
        sort_by_energy(&mut found.larger);
    }
    found.singles = alone.into_iter().map(|a| a.candidate).collect();
    if let Some(pair) = found
        .larger
        .first()
        .filter(|pair| leaves(log, &pair.held_out) > CLAIM_DEG)
    {
        let triples = grow(log, catalogue, pair, FITTED[2]);
        let parts = parts(log, catalogue, &found, &triples);
        found.larger.extend(triples.into_iter().chain(parts));
        sort_by_energy(&mut found.larger);
    }
    found
}

/// The recalibrated nominal model; `lines` is its start.
pub fn recalibrated(log: &Observed, lines: &[Line; 3]) -> Candidate {
    Candidate::new(&settle(
        Problem::new(log, Model::new(&[])),
        &nominal_theta(lines, log.rig.prior_lag_s),
    ))
}

/// The most that a sensor's RMSE is above its noise, degrees or °/s.
fn leaves(log: &Observed, h: &HeldOut) -> f64 {
    log.quantities()
        .map(|q| h.rmse_deg[q] - 3f64.sqrt() * log.noise_deg[q])
        .fold(0.0, f64::max)
}

/// How many pairs are fitted: none where no two effects could be claimed, and half as many where the best single leaves less than can be
/// claimed, because a single that is not in the log can stand for two that are.
fn pairs(log: &Observed, nominal: &HeldOut, best: &HeldOut) -> [usize; 2] {
    let [extended, screened, _] = FITTED;
    match leaves(log, best) {
        _ if leaves(log, nominal) < CLAIM_DEG => [0; 2],
        left if left > CLAIM_DEG => [extended, screened],
        left if left > CLAIM_DEG / 2.0 => [extended / 2, screened / 2],
        _ => [0; 2],
    }
}

/// Fits a problem until it converges.
fn settle<'a>(problem: Problem<'a>, start: &[f64]) -> BaseFit<'a> {
    let (mut point, mut tangent) = fit(&problem, start, ROUNDS);
    let several = problem.model.effects.len() > 1;
    for _ in 0..DATED[usize::from(several)] {
        let again = |slow_too: bool| {
            dated_again(&problem, &point, slow_too).map(|dated| fit(&problem, &dated, ROUNDS))
        };
        let better = |(p, _): &(Point, Tangent)| p.data() < DATED_GAIN * point.data();
        let Some(next) = again(false)
            .filter(better)
            .or_else(|| (!several).then(|| again(true))?.filter(better))
        else {
            break;
        };
        (point, tangent) = next;
    }
    BaseFit {
        problem,
        point,
        tangent,
    }
}

/// The fit of the named effects from this start.
fn fitted(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    names: &[&str],
    start: &[f64],
) -> Candidate {
    Candidate::new(&settle(
        Problem::new(log, Model::named(catalogue, names)),
        start,
    ))
}

/// The most promising extensions of a set by one effect, by Schwarz's criterion.
fn grow(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    seed: &Candidate,
    wanted: usize,
) -> Vec<Candidate> {
    let base = settle(
        Problem::new(log, Model::named(catalogue, &seed.names)),
        &seed.fitted.theta,
    );
    let names = |e: &dyn Effect| [seed.names.as_slice(), &[e.name()]].concat();
    let extended = |e: &dyn Effect| Problem::new(log, Model::named(catalogue, &names(e)));
    let mut promising: Vec<(&dyn Effect, Start)> = catalogue
        .par_iter()
        .map(AsRef::as_ref)
        .filter(|e| !seed.names.contains(&e.name()))
        .filter_map(|e| best_start(&base, &extended(e), e).map(|s| (e, s)))
        .collect();
    let criterion = |(e, s): &(&dyn Effect, Start)| schwarz(log, s.predicted, e.params().len());
    promising.sort_by(|a, b| criterion(a).total_cmp(&criterion(b)));
    promising.truncate(wanted);
    promising
        .par_iter()
        .map(|(e, s)| fitted(log, catalogue, &names(*e), &s.theta))
        .collect()
}

/// The pairs in these triples that have not been fitted: a triple is claimed for what each effect adds to the other two.
fn parts(
    log: &Observed,
    catalogue: &[Box<dyn Effect>],
    found: &Candidates<Candidate>,
    triples: &[Candidate],
) -> Vec<Candidate> {
    let mut missing: Vec<(Vec<&str>, Vec<f64>)> = Vec::new();
    for triple in triples {
        for left_out in &triple.names {
            let names: Vec<&str> = triple
                .names
                .iter()
                .copied()
                .filter(|n| n != left_out)
                .collect();
            let (whole, part) = (
                Model::named(catalogue, &triple.names),
                Model::named(catalogue, &names),
            );
            let start = part.extended(&whole, &triple.fitted.theta, |_| vec![]);
            if found.set(&names).is_none() && missing.iter().all(|(known, _)| *known != names) {
                missing.push((names, start));
            }
        }
    }
    missing
        .par_iter()
        .map(|(names, start)| fitted(log, catalogue, names, start))
        .collect()
}
