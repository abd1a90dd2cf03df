//! Which set of effects explains the log: every single one, then pairs grown from the best.
//!
//! All singles are fitted on the whole log from their most promising beginning and scored on left-out
//! blocks. The best few are grown by every other effect (forward): the tangent says which are worth a
//! fit. A grown set counts only if each member is needed (backward, in [`crate::diagnosis::decide`]).

use crate::diagnosis::begin::{BaseFit, begin, dated_anew};
use crate::diagnosis::chain::Model;
use crate::diagnosis::decide::CLAIM_DEG;
use crate::diagnosis::fit::{Fitted, Point, bounds, fit_with_slope, nominal_start};
pub use crate::diagnosis::holdout::{HeldOut, leave_out, score};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::slope::Tangent;
use crate::model::effects::Effect;
use crate::model::transmission::Line;
use rayon::prelude::*;

/// Rounds of a fit.
const ROUNDS: usize = 8;
/// Singles that are grown to pairs.
const BEAM: usize = 3;
/// Pairs that are fitted from each single.
const GROWN: usize = 5;

/// How often events are dated anew after a fit.
const DATED: usize = 2;

/// A set of effects with its fit and its scores.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Names, in catalogue order.
    pub names: Vec<&'static str>,
    /// Fit on the whole log.
    pub fitted: Fitted,
    /// Held-out scores.
    pub held_out: HeldOut,
}

impl Candidate {
    /// Held-out energy, deg².
    #[must_use]
    pub fn energy(&self) -> f64 {
        self.held_out.energy()
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

/// Runs the search.
#[must_use]
pub fn search(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3]) -> Found {
    let (nominal, base_fit) = settled(log, Model::new(&[]), &nominal_start(lines));
    let mut singles: Vec<Candidate> = catalogue.par_iter().map(|e| grown(log, &base_fit, e.as_ref(), None)).collect();
    by_energy(&mut singles);
    let mut pairs = Vec::new();
    if singles.first().is_some_and(|s| room(log, &s.held_out)) {
        for seed in &singles[..singles.len().min(BEAM)] {
            let known: Vec<Vec<&str>> = pairs.iter().map(|p: &Candidate| p.names.clone()).collect();
            pairs.extend(grow(log, catalogue, seed, &known));
        }
        by_energy(&mut pairs);
    }
    Found { nominal, singles, pairs }
}

/// Whether a further effect could gain what is worth a claim at all.
fn room(log: &Observed, h: &HeldOut) -> bool {
    (0..4).any(|k| h.rmse_deg[k] - 3f64.sqrt() * log.noise_deg[k] > CLAIM_DEG)
}

fn by_energy(list: &mut [Candidate]) {
    list.sort_by(|a, b| a.energy().total_cmp(&b.energy()));
}

/// Effects of a candidate, in catalogue order.
#[must_use]
pub fn model_of<'a>(catalogue: &'a [Box<dyn Effect>], names: &[&str]) -> Model<'a> {
    let effects: Vec<&dyn Effect> = catalogue.iter().map(AsRef::as_ref).filter(|e| names.contains(&e.name())).collect();
    Model::new(&effects)
}

/// Fits a model to the end and scores it.
fn settled<'a>(log: &Observed, model: Model<'a>, start: &[f64]) -> (Candidate, BaseFit<'a>) {
    let (mut fitted, mut tangent) = fit_with_slope(log, &model, start, ROUNDS, true);
    for _ in 0..DATED {
        let Some(anew) = dated_anew(log, &model, &fitted.theta) else { break };
        let again = fit_with_slope(log, &model, &anew, ROUNDS, true);
        if again.0.cost > 0.99 * fitted.cost {
            break;
        }
        (fitted, tangent) = again;
    }
    let (bounds, all) = (bounds(&model), vec![1.0; log.bins.len()]);
    let point = Point::new(log, &model, &bounds, fitted.theta.clone(), &all);
    let tangent = tangent.unwrap_or_else(|| Tangent::new(log, &model, &point, &bounds, &all));
    let held_out = leave_out(log, &model, &point, &tangent);
    let names = model.effects.iter().map(|e| e.name()).collect();
    (Candidate { names, fitted, held_out }, BaseFit { model, point, tangent })
}

/// The ground with one effect more, in catalogue order as `order` gives it.
fn grown(log: &Observed, base_fit: &BaseFit<'_>, added: &dyn Effect, to: Option<Model<'_>>) -> Candidate {
    let to = to.unwrap_or_else(|| Model::new(&[added]));
    let start = begin(log, base_fit, &to, added).map_or_else(|| base_fit.point.theta.clone(), |b| b.theta);
    settled(log, to, &start).0
}

/// Pairs of a single with what promises most.
fn grow(log: &Observed, catalogue: &[Box<dyn Effect>], seed: &Candidate, known: &[Vec<&str>]) -> Vec<Candidate> {
    let (_, base_fit) = settled(log, model_of(catalogue, &seed.names), &seed.fitted.theta);
    let pair = |e: &dyn Effect| model_of(catalogue, &[seed.names[0], e.name()]);
    let fresh = |e: &dyn Effect| {
        let names: Vec<&str> = pair(e).effects.iter().map(|e| e.name()).collect();
        names.len() == 2 && !known.contains(&names)
    };
    let mut promising: Vec<_> = catalogue
        .par_iter()
        .filter(|e| fresh(e.as_ref()))
        .filter_map(|e| begin(log, &base_fit, &pair(e.as_ref()), e.as_ref()).map(|b| (e, b)))
        .collect();
    promising.sort_by(|a, b| a.1.predicted_gain.total_cmp(&b.1.predicted_gain));
    promising.truncate(GROWN);
    promising.par_iter().map(|(e, b)| settled(log, pair(e.as_ref()), &b.theta).0).collect()
}
