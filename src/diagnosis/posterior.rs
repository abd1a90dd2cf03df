//! Probabilities of what can be said of a log: a set of effects explains it, the nominal model does, or nothing in the catalogue does.
//!
//! Each statement has a score, and the probabilities are the softmax of the scores (a multinomial logistic regression). The score of
//! a set rises with the predictive density of the left-out blocks and falls with its freedom. The density of a block and sensor is that
//! of residuals whose variance is unknown ([`crate::diagnosis::holdout::density`]). The weights are fitted by `retroflex gap train` to
//! logs of machines whose laws are random deformations of the catalogue's ([`crate::diagnosis::train`]).

use crate::diagnosis::holdout::{CLAIM_DEG, HeldOut};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::predictable::predictable_rate_deg_s;
use crate::diagnosis::quantity::Quantity;
use crate::diagnosis::search::{Candidate, Candidates};
use nalgebra::SVector;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.15;
/// Largest predictable rate that counts, °/s.
const PREDICTABLE_MAX_DEG_S: f64 = 2.0;

/// Number of features.
pub const FEATURES: usize = 12;
/// The features. For every statement, the density of the left-out short blocks: the mean over the sensors, and that of the gyroscope (for
/// `unknown`, of the best set). For a set: the number of effects beyond the first; what the log tells about its parameters
/// ([`crate::diagnosis::fit::Fitted::information`]); the logarithm of the largest gain of a sensor over the least that is claimed, where it is
/// less; for two effects, the same of the lesser of their gains over one alone; and the part of the parameters that no usual form of the
/// cause has. For `none`, the logarithm of the largest RMS of a sensor above the noise, degrees. For `unknown`: the same with the best
/// set, the density of its long blocks, that of the short blocks with the nominal model, and the rate of the gyroscope's residual that its
/// reading predicts, °/s.
const NAMES: [&str; FEATURES] = [
    "density",
    "density_gyro",
    "further_effects",
    "information",
    "claim",
    "second_claim",
    "unusual",
    "none_worst",
    "unknown_worst",
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
    let nominal = &found.nominal;
    let sets = || found.singles.iter().chain(&found.pairs);
    let [long, short] = [0, 1].map(|k| move |c: &Candidate| log.mean(&c.held_out.density[k]));
    let merit = |c: &&Candidate| long(c) + short(c) + 2.0 * PER_EFFECT * c.names.len() as f64;
    let best = sets().min_by(|a, b| merit(a).total_cmp(&merit(b))).unwrap_or(nominal);
    let density = |c: &Candidate| [-short(c), if log.has[Quantity::Gyro] { -c.held_out.density[1][Quantity::Gyro] } else { 0.0 }];
    let of_set = |c: &'a Candidate| {
        let claim = |before: &Candidate| (before.held_out.gain(&c.held_out).max(1e-3) / CLAIM_DEG).ln().min(0.0);
        let further = c.names.len() as f64 - 1.0;
        let lesser = c.names.iter().filter_map(|n| found.single(n)).map(claim).fold(0.0, f64::min);
        let information = (c.fitted.information - nominal.fitted.information) / 10.0;
        let own = [further, information, claim(nominal), if further > 0.0 { lesser } else { 0.0 }, c.unusual];
        (Some(c), features(density(c), own, 0.0, [0.0; 4]))
    };
    let none = features(density(nominal), [0.0; 5], worst_deg(log, &nominal.held_out).ln(), [0.0; 4]);
    let predictable = predictable_rate_deg_s(log, &best.held_out).min(PREDICTABLE_MAX_DEG_S);
    let unknown = features(density(best), [0.0; 5], 0.0, [worst_deg(log, &best.held_out).ln(), long(best), short(nominal), predictable]);
    let all = sets().map(of_set).chain([(Some(nominal), none), (None, unknown)]);
    all.map(|(set, features)| Statement { set, features }).collect()
}

/// Features of a statement: the densities, those of a set, of `none`, and of `unknown`.
fn features(density: [f64; 2], set: [f64; 5], none: f64, unknown: [f64; 4]) -> Features {
    Features::from_iterator(density.into_iter().chain(set).chain([none]).chain(unknown))
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
