//! Probabilities of what can be said of a log: a set of effects explains it, the nominal model does, or nothing in the catalogue does.
//!
//! Each statement has features and a score, their weighted sum; the probabilities are the softmax of the scores (a multinomial logistic
//! regression). The weights are a [`Head`], fitted by `retroflex gap train` to logs of random machines ([`crate::diagnosis::train`]):
//! one for a tip ([`crate::diagnosis::features`]), one for other rigs ([`crate::diagnosis::map::features`]).

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Weights of named features, and the level of the sets that are probable together.
#[derive(Debug, Clone, PartialEq)]
pub struct Head {
    /// Names of the features, in their order.
    pub names: Vec<String>,
    /// Weight of each feature.
    pub weights: Vec<f64>,
    /// Probability that the statements of a conformal set have together.
    pub conformal: f64,
}

/// A head as its file has it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct HeadFile {
    conformal: f64,
    weight: BTreeMap<String, f64>,
}

impl Head {
    /// Reads the weights of these features; the weight of a feature that the text lacks is 0.
    ///
    /// # Errors
    /// A text that is not TOML, or names another feature.
    pub fn read(text: &str, names: Vec<String>) -> Result<Self, String> {
        let HeadFile { conformal, weight } = toml::from_str(text).map_err(|e| e.to_string())?;
        match weight.keys().find(|k| !names.contains(k)) {
            Some(other) => Err(format!("`{other}` is no feature")),
            None => Ok(Self {
                weights: names
                    .iter()
                    .map(|n| weight.get(n).copied().unwrap_or(0.0))
                    .collect(),
                names,
                conformal,
            }),
        }
    }

    /// The weights that are a part of the program, of all features of a layout.
    ///
    /// # Panics
    /// On a text that [`Head::read`] refuses; a test reads each.
    #[expect(
        clippy::expect_used,
        reason = "the text is a part of the program, and a test reads it"
    )]
    pub fn built_in(text: &str, layout: &Layout) -> Self {
        Self::read(text, layout.names()).expect("a test reads the weights of the program")
    }

    /// The weights as TOML.
    ///
    /// # Errors
    /// Values that TOML cannot hold.
    pub fn text(&self) -> Result<String, toml::ser::Error> {
        let weight = self
            .names
            .iter()
            .cloned()
            .zip(self.weights.iter().copied())
            .collect();
        toml::to_string(&HeadFile {
            conformal: self.conformal,
            weight,
        })
    }
}

/// Names of common features, and of the effects that have a feature each: `form_` and the name, for `unknown` where the best set has the
/// effect. A right effect whose law has another form leaves something too, more for some effects than for others.
pub struct Layout {
    /// Names of the common features.
    pub common: &'static [&'static str],
    /// Names of the effects.
    pub effects: Vec<&'static str>,
}

impl Layout {
    /// Names of all features.
    pub fn names(&self) -> Vec<String> {
        self.common
            .iter()
            .map(|n| (*n).to_owned())
            .chain(self.effects.iter().map(|n| format!("form_{n}")))
            .collect()
    }

    /// All features: the common ones and those of the effects in `best`.
    pub fn features(&self, common: impl IntoIterator<Item = f64>, best: &[&str]) -> Vec<f64> {
        common
            .into_iter()
            .chain(
                self.effects
                    .iter()
                    .map(|name| f64::from(u8::from(best.contains(name)))),
            )
            .collect()
    }
}

/// A statement about a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Statement {
    /// The effects that explain the log, none for the nominal model; `None` for `unknown`.
    pub names: Option<Vec<&'static str>>,
    /// The features, in the order of a [`Head`].
    pub features: Vec<f64>,
}

/// Probabilities of statements with these features.
pub fn probabilities<'a>(features: impl Iterator<Item = &'a [f64]>, weights: &[f64]) -> Vec<f64> {
    let scores: Vec<f64> = features
        .map(|x| x.iter().zip(weights).map(|(x, w)| x * w).sum())
        .collect();
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
pub struct Posterior {
    /// Names and probability, the most probable first; `None` is `unknown`.
    pub ranked: Vec<(Option<Vec<&'static str>>, f64)>,
    /// How many of them make up the conformal set.
    pub conformal: usize,
}

impl Posterior {
    /// The posterior of these statements.
    pub fn new(head: &Head, statements: Vec<Statement>) -> Self {
        let p = probabilities(
            statements.iter().map(|s| s.features.as_slice()),
            &head.weights,
        );
        let conformal = conformal_set(&p, head.conformal).len();
        let mut ranked: Vec<_> = statements.into_iter().map(|s| s.names).zip(p).collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
        Self { ranked, conformal }
    }

    /// Probability that a statement for which `of` holds is true.
    fn sum(&self, of: impl Fn(Option<&[&'static str]>) -> bool) -> f64 {
        self.ranked
            .iter()
            .filter(|(s, _)| of(s.as_deref()))
            .map(|(_, p)| p)
            .sum()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_is_written_and_read_and_another_feature_is_refused() {
        let names = || vec!["density".to_owned(), "claim".to_owned()];
        let head = Head {
            names: names(),
            weights: vec![3.5, -1.0],
            conformal: 0.9,
        };
        let text = head.text().unwrap();
        assert_eq!(Head::read(&text, names()).unwrap(), head);
        assert_eq!(
            Head::read(&text, vec!["density".to_owned()]).unwrap_err(),
            "`claim` is no feature"
        );
    }

    #[test]
    fn equal_statements_share_the_probability_and_a_conformal_set_has_both() {
        let p = probabilities(
            [[1.0, 4.0], [4.0, 1.0], [-3.0, 0.0]]
                .iter()
                .map(<[f64; 2]>::as_slice),
            &[1.0; 2],
        );
        assert!(
            (p[0] - 0.5).abs() < 1e-3 && (p.iter().sum::<f64>() - 1.0).abs() < 1e-12,
            "{p:?}"
        );
        let mut set = conformal_set(&p, 0.95);
        set.sort_unstable();
        assert_eq!(set, [0, 1]);
        assert_eq!(conformal_set(&[0.97, 0.02, 0.01], 0.95), [0]);
    }
}
