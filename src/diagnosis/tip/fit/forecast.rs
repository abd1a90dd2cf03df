//! The model that predicts best, for a feedforward or a simulation.
//!
//! A verdict names as few causes as the log proves. A prediction may use more: every effect that acts all the time and has few
//! valleys is fitted at once, under the priors of the catalogue. An effect with many valleys joins them if one step of it
//! promises enough. Effects whose parameters a Wald test does not separate from their vanishing point are then removed. Of the
//! nominal model, the verdict's set, the whole and the reduced set, the one that leaves the least on blocks that the fit has not
//! seen is returned.

use crate::diagnosis::Scored;
use crate::diagnosis::tip::fit::{BaseFit, Candidate, LeastSquares, Start, fit, grown, vanishing};
use crate::diagnosis::tip::observed::Observed;
use crate::model::Model;
use crate::model::effects::{Effect, Stage, catalogue};
use nalgebra::DVector;

/// Rounds of a fit.
const ROUNDS: usize = 8;
/// Starting points beyond which an effect is fitted only if it promises enough.
const STARTS_MAX: usize = 3;
/// The same for the parameters of a sensor effect.
const PARAMETERS_MAX: usize = 12;
/// Part of the sum of squares that such an effect must promise to leave at most.
const PROMISE: f64 = 0.85;
/// Such effects that are added at most.
const ADDED_MAX: usize = 2;
/// Wald statistic per parameter below which an effect is removed: the 2 of Akaike's criterion, times the forty bins over which
/// the residuals are correlated (2 s).
const WALD_MIN: f64 = 2.0 * 40.0;
/// Share by which a reduced set may leave more than the whole.
const WORSE_MAX: f64 = 1.02;

/// The model that leaves the least on unseen blocks, among those between `nominal` and the whole catalogue.
pub fn best_predicting(log: &Observed, nominal: &Candidate, chosen: &Candidate) -> Candidate {
    // every effect that `from` lacks starts at its vanishing point
    let fitted = |effects: &[&'static dyn Effect], from: &Candidate| {
        let model = Model::new(effects);
        let start = model.extended(&from.model, &from.theta, vanishing);
        fit(LeastSquares::new(log, model), &start, ROUNDS)
    };
    let mut used = catalogue().to_vec();
    used.retain(|e| is_steady(*e) || chosen.names.contains(&e.name()));
    let mut base = fitted(&used, chosen);
    let mut all = vec![Candidate::new(&base)];
    for _ in 0..ADDED_MAX {
        let sets = grown(&base, catalogue()).into_iter();
        let best = sets.min_by(|a, b| a.1.predicted.total_cmp(&b.1.predicted));
        let promises = |s: &Start| s.predicted < PROMISE * base.point.total();
        let Some((model, start)) = best.filter(|(_, start)| promises(start)) else {
            break;
        };
        base = fit(LeastSquares::new(log, model), &start.theta, ROUNDS);
        all.push(Candidate::new(&base));
    }
    let all = all.into_iter();
    let least = all.min_by(|a, b| a.energy().total_cmp(&b.energy()));
    let whole = least.unwrap_or_else(|| chosen.clone());
    let last = whole.model == base.problem.model;
    let spared = if last { weak(&base) } else { vec![] };
    let mut kept = whole.model.effects.clone();
    kept.retain(|e| !spared.contains(&e.name()));
    let reduced = Candidate::new(&fitted(&kept, &whole));
    let better = reduced.energy() <= WORSE_MAX * whole.energy();
    let best = if better { &reduced } else { &whole };
    let all = [best, nominal, chosen].into_iter();
    let least = all.min_by(|a, b| a.energy().total_cmp(&b.energy()));
    least.unwrap_or(best).clone()
}

/// Whether an effect acts all the time, can be fed forward or disturbs the readings, and has few valleys.
fn is_steady(e: &dyn Effect) -> bool {
    let info = e.info();
    let steady = !info.is_event()
        && !matches!(info.stage, Stage::Timing | Stage::Base)
        && e.starts().len() <= STARTS_MAX;
    steady && (info.stage != Stage::Sensor || info.params.len() <= PARAMETERS_MAX)
}

/// Effects whose parameters the log does not separate from their vanishing point.
fn weak(base: &BaseFit<'_>) -> Vec<&'static str> {
    let (problem, point) = (&base.problem, &base.point);
    let sums = base.tangent.sums(problem, point);
    let Some(covariance) = sums.normal.try_inverse() else {
        return vec![];
    };
    let model = &problem.model;
    let spared = |&i: &usize| {
        let (from, n) = (model.at[i], model.at[i + 1] - model.at[i]);
        let away = DVector::from_fn(n, |k, _| {
            let bound = &problem.bounds[from + k];
            (point.theta[from + k] - bound.start) / bound.scale
        });
        let own = covariance.view((from, from), (n, n)).into_owned();
        own.cholesky().map_or(0.0, |c| away.dot(&c.solve(&away))) < WALD_MIN * n as f64
    };
    let spared = (0..model.effects.len()).filter(spared);
    spared.map(|i| model.effects[i].name()).collect()
}
