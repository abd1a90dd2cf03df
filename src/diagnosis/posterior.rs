//! Probabilities of what can be said of a log: a set of effects explains it, the nominal model does, or nothing in the catalogue does.
//!
//! Each statement has a score, and the probabilities are the softmax of the scores (a multinomial logistic regression). The score of
//! a set rises with the predictive density of the left-out blocks and falls with its freedom. The density of a block and sensor is that
//! of residuals whose variance is unknown: the logarithm of their mean square, in units of the bins' standard deviations, so that no
//! sum mixes units and one block with an error of form counts as one block. The weights are fitted by `retroflex gap train` to logs
//! of machines whose laws are random deformations of the catalogue's ([`crate::diagnosis::train`]).

use crate::diagnosis::bins::BIN_S;
use crate::diagnosis::holdout::{CLAIM_DEG, HeldOut};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::predictable::predictable_rate_deg_s;
use crate::diagnosis::quantity::Quantity;
use crate::diagnosis::search::{Candidate, Candidates};
use crate::model::NOMINAL;
use nalgebra::{SVector, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Length of a block, s.
const BLOCK_S: f64 = 12.0;
/// Mean square that noise alone leaves in any block, in units of the bins' variances.
const FLOOR: f64 = 0.03;
/// Parameters per effect beyond which more of them do not count.
const PARAMETERS_MAX: usize = 6;
/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.15;
/// Largest predictable rate that counts, °/s.
const PREDICTABLE_MAX_DEG_S: f64 = 2.0;

/// Number of features.
pub const FEATURES: usize = 10;
/// The features: for every statement `density`, the mean logarithm of the mean square of the left-out residuals over blocks and sensors
/// (for `unknown` that of the best set); for a set the number of effects beyond the first, that of parameters, the logarithm of the
/// largest gain of a sensor over the least that is claimed where it is less, and the part of the parameters that no usual form of the
/// cause has; for `none` the logarithm of the largest RMS of a sensor above the noise, degrees; for `unknown` a constant, the densities of
/// the best set and of the nominal model, and the rate of the gyroscope's residual that its reading predicts, °/s.
const NAMES: [&str; FEATURES] = [
    "density",
    "further_effects",
    "parameters",
    "claim",
    "unusual",
    "none_worst",
    "unknown",
    "unknown_best",
    "unknown_nominal",
    "unknown_predictable",
];

/// Features of a statement, in the order of their names.
pub type Features = SVector<f64, FEATURES>;

/// Weights of the features, and the level of the sets that are probable together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Probability that the statements of a conformal set have together.
    pub conformal: f64,
    /// Weight of each feature.
    weight: BTreeMap<String, f64>,
}

/// The weights that diagnoses use.
#[expect(clippy::expect_used, reason = "the text is a part of the program, and a test reads it")]
static WEIGHTS: LazyLock<Weights> = LazyLock::new(|| toml::from_str(include_str!("posterior.toml")).expect("posterior.toml is tested"));

impl Weights {
    /// The weights that diagnoses use.
    pub fn trained() -> &'static Self {
        &WEIGHTS
    }

    /// Weights of a vector.
    pub fn new(w: &Features, conformal: f64) -> Self {
        Self { conformal, weight: NAMES.map(str::to_owned).into_iter().zip(w.iter().copied()).collect() }
    }

    /// The weights as a vector; a missing one is 0.
    pub fn vector(&self) -> Features {
        Features::from(NAMES.map(|name| self.weight.get(name).copied().unwrap_or(0.0)))
    }
}

/// What can be said of a log, with the features of the statement.
#[derive(Debug, Clone)]
pub struct Statement<'a> {
    /// The set that explains the log, empty for `none`; `None` for `unknown`.
    pub set: Option<&'a Candidate>,
    /// The features.
    pub features: Features,
}

/// All statements about a log: each set, the nominal model, `unknown`.
pub fn statements<'a>(log: &Observed, found: &'a Candidates) -> Vec<Statement<'a>> {
    let nominal = density(log, &found.nominal.held_out);
    let sets = found.singles.iter().chain(&found.pairs).map(|c| (c, density(log, &c.held_out)));
    let sets: Vec<(&Candidate, f64)> = sets.collect();
    let merit = |&(c, d): &(&Candidate, f64)| d + PER_EFFECT * c.names.len() as f64;
    let best = sets.iter().min_by(|a, b| merit(a).total_cmp(&merit(b)));
    let (best, least) = best.map_or((&found.nominal, nominal), |&(c, d)| (c, d));
    let predictable = predictable_rate_deg_s(log, &best.held_out).min(PREDICTABLE_MAX_DEG_S);
    let of_set = |&(c, density): &(&'a Candidate, f64)| {
        let effects = c.names.len();
        let free = (c.fitted.theta.len() - NOMINAL).min(PARAMETERS_MAX * effects);
        let gain = found.nominal.held_out.gain(&c.held_out).max(1e-3);
        let claim = (gain / CLAIM_DEG).ln().min(0.0);
        let features = Features::from([-density, effects as f64 - 1.0, free as f64, claim, c.unusual, 0.0, 0.0, 0.0, 0.0, 0.0]);
        Statement { set: Some(c), features }
    };
    let worst = worst_deg(log, &found.nominal.held_out).ln();
    let none = Features::from([-nominal, 0.0, 0.0, 0.0, 0.0, worst, 0.0, 0.0, 0.0, 0.0]);
    let unknown = Features::from([-least, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, least, nominal, predictable]);
    let rest = [Statement { set: Some(&found.nominal), features: none }, Statement { set: None, features: unknown }];
    sets.iter().map(of_set).chain(rest).collect()
}

/// Probabilities of statements with these features.
pub fn probabilities(features: impl Iterator<Item = Features>, weights: &Features) -> Vec<f64> {
    let scores: Vec<f64> = features.map(|x| x.dot(weights)).collect();
    let best = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = scores.iter().map(|s| (s - best).exp()).sum();
    scores.iter().map(|s| (s - best).exp() / total).collect()
}

/// The statements that have at least `level` of the probability together, the most probable first.
pub fn conformal_set(p: &[f64], level: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[b].total_cmp(&p[a]));
    let mut sum = 0.0;
    let enough = order.iter().position(|&i| {
        sum += p[i];
        sum >= level
    });
    order.truncate(enough.map_or(p.len(), |n| n + 1));
    order
}

/// Statements about a log with their probabilities.
#[derive(Debug, Clone)]
pub struct Posterior<'a> {
    /// Statement and probability, the most probable first.
    pub ranked: Vec<(Option<&'a Candidate>, f64)>,
    /// How many of them make up the conformal set.
    pub conformal: usize,
}

impl<'a> Posterior<'a> {
    /// The posterior of a log.
    pub fn new(log: &Observed, found: &'a Candidates) -> Self {
        let (weights, statements) = (Weights::trained(), statements(log, found));
        let p = probabilities(statements.iter().map(|s| s.features), &weights.vector());
        let conformal = conformal_set(&p, weights.conformal).len();
        let mut ranked: Vec<_> = statements.iter().zip(p).map(|(s, p)| (s.set, p)).collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self { ranked, conformal }
    }

    /// Probability that a statement for which `of` holds is true.
    pub fn sum(&self, of: impl Fn(Option<&Candidate>) -> bool) -> f64 {
        self.ranked.iter().filter(|(s, _)| of(*s)).map(|(_, p)| p).sum()
    }

    /// Probability that an effect is present.
    pub fn effect(&self, name: &str) -> f64 {
        self.sum(|s| s.is_some_and(|c| c.names.contains(&name)))
    }

    /// Probability that nothing in the catalogue explains the log.
    pub fn unknown(&self) -> f64 {
        self.sum(|s| s.is_none())
    }
}

/// Largest RMS of a sensor above the noise, degrees or °/s.
fn worst_deg(log: &Observed, h: &HeldOut) -> f64 {
    let above = |q| (h.rmse_deg[q].powi(2) - 3.0 * log.noise_deg[q].powi(2)).max(0.0).sqrt();
    log.quantities().map(above).fold(0.05, f64::max)
}

/// Mean over sensors and blocks of the logarithm of the mean square of the left-out residuals, in units of their variances.
fn density(log: &Observed, h: &HeldOut) -> f64 {
    let of = |q| sensor_density(log, h, q);
    log.quantities().map(of).sum::<f64>() / log.quantities().count() as f64
}

fn sensor_density(log: &Observed, h: &HeldOut, q: Quantity) -> f64 {
    let mut blocks: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    let scored = log.bins.iter().zip(&h.residual[q]).filter(|(b, r)| b.weight[q] > 0.0 && **r != Vector3::zeros());
    for (bin, r) in scored {
        let sum = blocks.entry(((bin.t_s - log.start_s()) / BLOCK_S) as usize).or_default();
        *sum = (sum.0 + bin.weight[q].powi(2) * r.norm_squared(), sum.1 + 3.0 * bin.lasting_s / BIN_S);
    }
    blocks.values().map(|(square, n)| (square / n + FLOOR).ln()).sum::<f64>() / blocks.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        let w = Weights::trained();
        assert!(w.vector()[0] > 0.0 && (0.5..1.0).contains(&w.conformal), "{w:?}");
        assert_eq!(Weights::new(&w.vector(), w.conformal), *w, "every weight has the name of a feature");
    }

    #[test]
    fn equal_statements_share_the_probability_and_a_conformal_set_has_both() {
        let x = Features::from([1.0; FEATURES]);
        let p = probabilities([x, x, x * -1.0].into_iter(), &Features::from([1.0; FEATURES]));
        assert!((p[0] - 0.5).abs() < 1e-6 && (p.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{p:?}");
        let mut set = conformal_set(&p, 0.95);
        set.sort_unstable();
        assert_eq!(set, [0, 1]);
        assert_eq!(conformal_set(&[0.97, 0.02, 0.01], 0.95), [0]);
    }
}
