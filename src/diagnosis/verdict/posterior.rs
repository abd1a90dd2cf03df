//! Probabilities of what can be said of a log: a set of effects explains it, the nominal model does, or nothing in the catalogue does.
//!
//! Each statement has features and a score, their weighted sum; the probabilities are the softmax of the scores (a multinomial logistic
//! regression). The weights are a [`Head`], fitted by `examples/gap_train` to logs of random machines: one for a tip, one for other rigs
//! ([`crate::diagnosis::problem::Problem::head`]).

use serde::Deserialize;
use std::collections::BTreeMap;

/// A feature by its name, with its value.
pub type Feature = (&'static str, f64);

/// Weights of features, and the level of the sets that are probable together.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// Probability that the statements of a conformal set have together.
    pub conformal: f64,
    /// Weight of each feature.
    pub weight: BTreeMap<String, f64>,
}

impl Head {
    /// The weights in a text that is a part of the program.
    ///
    /// # Panics
    /// On a text that is not TOML; a test reads each.
    #[expect(
        clippy::expect_used,
        reason = "the text is a part of the program, and a test reads it"
    )]
    pub fn built_in(text: &str) -> Self {
        toml::from_str(text).expect("a head is TOML")
    }

    /// The weighted sum of features; the weight of one that the head lacks is 0.
    fn score(&self, features: &[(String, f64)]) -> f64 {
        let is_known = |(name, _): &(String, f64)| self.weight.contains_key(name);
        debug_assert!(features.iter().all(is_known), "no weights: {features:?}");
        let weight = |name: &String| self.weight.get(name).copied().unwrap_or(0.0);
        features.iter().map(|(name, x)| x * weight(name)).sum()
    }
}

/// A statement about a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Statement {
    /// The effects that explain the log, none for the nominal model; `None` for `unknown`.
    pub names: Option<Vec<&'static str>>,
    /// The features that it has; all others are 0.
    pub features: Vec<(String, f64)>,
    /// What may be claimed of the set; of no meaning for `unknown`.
    pub claim: Claim,
}

/// Probabilities of statements with these scores.
pub fn probabilities(scores: &[f64]) -> Vec<f64> {
    let best = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = scores.iter().map(|s| (s - best).exp()).sum();
    scores.iter().map(|s| (s - best).exp() / total).collect()
}

/// Statements with their probabilities: the names of a set, or `None` for `unknown`.
pub type Said = (Option<Vec<&'static str>>, f64);

/// What may be claimed of a set of effects; nothing by default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Claim {
    /// The effects that explain enough; `None` for a set that says nothing.
    pub names: Option<Vec<&'static str>>,
    /// Part of the probability that goes to `unknown`, because the set leaves more than an effect of another form would.
    pub unexplained: f64,
}

impl Claim {
    /// The claim of these effects, which leave nothing.
    pub fn of(names: Vec<&'static str>) -> Self {
        Self {
            names: Some(names),
            ..Self::default()
        }
    }

    /// The claims of a statement that has the probability `p`.
    pub fn said(self, p: f64) -> Vec<Said> {
        let explained = 1.0 - self.unexplained;
        let said = |names| vec![(Some(names), p * explained), (None, p * self.unexplained)];
        self.names.map_or(vec![], said)
    }
}

/// Adds the probabilities of equal statements and divides them by the sum of all; the most probable comes first. Without any, it is
/// `unknown`.
fn ranked(said: impl IntoIterator<Item = Said>) -> Vec<Said> {
    let mut out: Vec<Said> = Vec::new();
    for (names, p) in said {
        match out.iter_mut().find(|(known, _)| *known == names) {
            Some((_, sum)) => *sum += p,
            None => out.push((names, p)),
        }
    }
    let total: f64 = out.iter().map(|s| s.1).sum();
    if total > 0.0 {
        out.iter_mut().for_each(|s| s.1 /= total);
    } else {
        out = vec![(None, 1.0)];
    }
    out.sort_by(|a, b| b.1.total_cmp(&a.1));
    out
}

/// Statements about a log with their probabilities.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// The statements, the most probable first.
    pub ranked: Vec<Said>,
    /// Probability that the statements of a conformal set have together.
    level: f64,
}

impl Posterior {
    /// The posterior of what may be claimed: a probability is that of an effect that is present and above the bar. A set of which nothing
    /// may be claimed is left out.
    pub fn new(head: &Head, statements: Vec<Statement>) -> Self {
        let scores = statements.iter().map(|s| head.score(&s.features));
        let p = probabilities(&scores.collect::<Vec<f64>>());
        let said = |(s, p): (Statement, f64)| match s.names {
            Some(_) => s.claim.said(p),
            None => vec![(None, p)],
        };
        Self::of(statements.into_iter().zip(p).flat_map(said), head.conformal)
    }

    /// The posterior of statements with these probabilities.
    pub fn of(said: impl IntoIterator<Item = Said>, level: f64) -> Self {
        let ranked = ranked(said);
        Self { ranked, level }
    }

    /// The statements of the conformal set: the most probable, as many as have the level together.
    pub fn conformal(&self) -> &[Said] {
        let mut sum = 0.0;
        let enough = self.ranked.iter().position(|(_, p)| {
            sum += p;
            sum >= self.level
        });
        &self.ranked[..enough.map_or(self.ranked.len(), |last| last + 1)]
    }

    /// The posterior of a log that cannot tell the effects of these pairs apart: they share the probability.
    #[must_use]
    pub fn shared(mut self, alike: &[[&'static str; 2]]) -> Self {
        for pair in alike {
            let of = |(names, p): Said| -> Vec<Said> {
                match names.as_deref().and_then(|names| exchanged(names, pair)) {
                    Some(other) => vec![(names, p / 2.0), (Some(other), p / 2.0)],
                    None => vec![(names, p)],
                }
            };
            self = Self::of(self.ranked.into_iter().flat_map(of), self.level);
        }
        self
    }

    /// Probability that a statement for which `of` holds is true.
    fn sum(&self, of: impl Fn(Option<&[&'static str]>) -> bool) -> f64 {
        let true_of = self.ranked.iter().filter(|(s, _)| of(s.as_deref()));
        true_of.fold(0.0, |sum, (_, p)| sum + p)
    }

    /// Probability that these effects, and no others, explain the log.
    pub fn set(&self, names: &[&str]) -> f64 {
        self.sum(|s| s.is_some_and(|s| s == names))
    }

    /// Probability that an effect is present.
    pub fn effect(&self, name: &str) -> f64 {
        self.sum(|s| s.is_some_and(|s| s.contains(&name)))
    }

    /// Probability that nothing in the catalogue explains the log.
    pub fn unknown(&self) -> f64 {
        self.sum(|s| s.is_none())
    }
}

/// A set with one effect of a pair in place of the other; `None` for a set with both or neither.
pub fn exchanged(names: &[&'static str], pair: &[&'static str; 2]) -> Option<Vec<&'static str>> {
    let [a, b] = pair.map(|name| names.iter().position(|n| *n == name));
    let (at, other) = match (a, b) {
        (Some(at), None) => (at, pair[1]),
        (None, Some(at)) => (at, pair[0]),
        _ => return None,
    };
    let mut names = names.to_vec();
    names[at] = other;
    Some(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_is_the_weighted_sum_of_features_that_the_head_names() {
        let head = Head::built_in("conformal = 0.9\n[weight]\nclaim = 3.5\ndensity = 2.0\n");
        let score = |name: &str| head.score(&[(name.to_owned(), 2.0), ("density".to_owned(), 1.0)]);
        assert_eq!(score("claim"), 9.0);
        assert_eq!(head.score(&[]), 0.0);
        if cfg!(debug_assertions) {
            assert!(std::panic::catch_unwind(|| score("clam")).is_err());
        }
    }

    #[test]
    fn equal_statements_share_the_probability_and_a_conformal_set_has_both() {
        let p = probabilities(&[5.0, 5.0, -3.0]);
        assert!(
            (p[0] - 0.5).abs() < 1e-3 && (p.iter().sum::<f64>() - 1.0).abs() < 1e-12,
            "{p:?}"
        );
        let sets = ["leak", "creep", "play"].map(|name| Some(vec![name]));
        let said = |p: &[f64]| {
            sets.clone()
                .into_iter()
                .zip(p.to_vec())
                .collect::<Vec<Said>>()
        };
        let named = |p: &[f64]| -> Vec<_> {
            let posterior = Posterior::of(said(p), 0.95);
            posterior.conformal().iter().map(|s| s.0.clone()).collect()
        };
        assert_eq!(named(&p), sets[..2]);
        assert_eq!(named(&[0.02, 0.97, 0.01]), sets[1..2]);
    }
}
