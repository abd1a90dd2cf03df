//! The weights of the features: maximum likelihood with a ridge, by Newton's method. The likelihood is concave.

use super::case::{Case, known};
use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use std::collections::BTreeMap;

/// Ridge per log.
const RIDGE: f64 = 1e-4;
/// Most steps.
const STEPS: usize = 100;
/// Gain per log below which a step is the last.
const CONVERGED: f64 = 1e-9;
/// Share of the logs of which a conformal set contains the truth.
const COVERED: f64 = 0.95;

/// A head as its file has it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Head {
    /// Probability that the statements of a conformal set have together.
    pub conformal: f64,
    /// Weight of each feature.
    pub weight: BTreeMap<String, f64>,
}

/// Weights and how they do on logs that they were not fitted to.
#[derive(Debug, Clone, PartialEq)]
pub struct Trained {
    /// The weights.
    pub head: Head,
    /// Logs that the weights were fitted to, logs of the check, and logs whose true set was not fitted by the search.
    pub logs: [usize; 3],
    /// Mean negative logarithm of the probability of the truth, on the logs of the check.
    pub loss: f64,
}

/// Fits the weights of the named features to the cases with an even seed and checks them on those with an odd one, which also give the
/// level of the conformal sets.
pub fn fit(cases: &[Case], names: Vec<String>) -> Trained {
    let of = |odd: u64| {
        cases
            .iter()
            .filter(move |c| c.seed % 2 == odd)
            .filter_map(|c| Some((c, c.right()?)))
    };
    let (fitted, check): (Vec<_>, Vec<_>) = (of(0).collect(), of(1).collect());
    let mut w = DVector::zeros(names.len());
    let mut value = likelihood(&fitted, &w);
    for _ in 0..STEPS {
        let (gradient, curvature) = slopes(&fitted, &w);
        let Some(step) = curvature.cholesky().map(|c| c.solve(&gradient)) else {
            break;
        };
        let tried = (0..20)
            .map(|k| &w + &step * 0.5f64.powi(k))
            .map(|next| (likelihood(&fitted, &next), next));
        let Some((better, next)) = tried.into_iter().find(|(v, _)| *v > value) else {
            break;
        };
        let gained = better - value;
        (w, value) = (next, better);
        if gained < CONVERGED {
            break;
        }
    }
    let p: Vec<(f64, f64)> = check
        .iter()
        .map(|(c, right)| needed(c, *right, w.as_slice()))
        .collect();
    let loss = -p
        .iter()
        .map(|(p, _)| p.max(f64::MIN_POSITIVE).ln())
        .sum::<f64>()
        / p.len().max(1) as f64;
    let logs = [
        fitted.len(),
        check.len(),
        cases.len() - fitted.len() - check.len(),
    ];
    Trained {
        head: Head {
            conformal: level(&p),
            weight: names.into_iter().zip(w.iter().copied()).collect(),
        },
        logs,
        loss,
    }
}

/// Probability of what may be claimed of the truth, and what all more probable claims have together.
fn needed(case: &Case, right: usize, w: &[f64]) -> (f64, f64) {
    let truth = &case.said[right];
    let claim = || truth.claim.names.as_deref().map(known).unwrap_or_default();
    let truth = truth.names.as_ref().map(|_| claim());
    let claimed = case.claimed(&case.probabilities(w));
    let p = claimed
        .iter()
        .find(|(names, _)| *names == truth)
        .map_or(0.0, |s| s.1);
    (p, claimed.iter().map(|s| s.1).filter(|x| *x > p).sum())
}

/// The least level at which the sets contain the truth often enough.
fn level(p: &[(f64, f64)]) -> f64 {
    let mut needed: Vec<f64> = p.iter().map(|p| p.1).collect();
    needed.sort_by(f64::total_cmp);
    let at =
        ((COVERED * (needed.len() + 1) as f64).ceil() as usize).clamp(1, needed.len().max(1)) - 1;
    needed.get(at).map_or(COVERED, |x| (x + 1e-6).min(1.0))
}

/// Mean log-likelihood with the ridge.
fn likelihood(cases: &[(&Case, usize)], w: &DVector<f64>) -> f64 {
    let of = |(c, right): &(&Case, usize)| {
        c.probabilities(w.as_slice())[*right]
            .max(f64::MIN_POSITIVE)
            .ln()
    };
    cases.iter().map(of).sum::<f64>() / cases.len().max(1) as f64 - RIDGE * w.norm_squared()
}

/// Gradient and negative curvature of the same.
fn slopes(cases: &[(&Case, usize)], w: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
    let (n, size) = (cases.len().max(1) as f64, w.len());
    let mut gradient = -w * (2.0 * RIDGE);
    let mut curvature = DMatrix::identity(size, size) * (2.0 * RIDGE);
    for (c, right) in cases {
        let p = c.probabilities(w.as_slice());
        let mut mean = DVector::zeros(size);
        c.features()
            .zip(&p)
            .for_each(|(x, p)| mean.axpy(*p, &DVector::from_column_slice(x), 1.0));
        gradient += (DVector::from_column_slice(&c.said[*right].features) - &mean) / n;
        for (x, p) in c.features().zip(&p) {
            let apart = DVector::from_column_slice(x) - &mean;
            curvature.ger(p / n, &apart, &apart, 1.0);
        }
    }
    (gradient, curvature)
}

#[cfg(test)]
mod tests {
    use super::super::case::{Claim, Said};
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use retroflex::diagnosis::verdict::{Posterior, probabilities};

    /// Cases drawn from known weights: a fit finds them, and the sets hold as often as they should.
    #[test]
    fn a_fit_recovers_the_weights_that_made_the_cases() {
        let mut rng = StdRng::seed_from_u64(1);
        let truth: Vec<f64> = (0..12).map(|i| [1.0, -0.5, 0.0][i % 3]).collect();
        let mut case = |seed: u64| {
            let features: Vec<Vec<f64>> = (0..6)
                .map(|_| truth.iter().map(|_| rng.random_range(-2.0..2.0)).collect())
                .collect();
            let score = |x: &Vec<f64>| x.iter().zip(&truth).map(|(x, w)| x * w).sum();
            let p = probabilities(&features.iter().map(score).collect::<Vec<f64>>());
            let mut drawn: f64 = rng.random();
            let right = p.iter().position(|p| {
                drawn -= p;
                drawn < 0.0
            });
            let name = |k: usize| Some(vec![k.to_string()]);
            let said = features
                .into_iter()
                .enumerate()
                .map(|(k, features)| Said {
                    names: name(k),
                    features,
                    claim: Claim {
                        names: name(k),
                        unexplained: 0.0,
                    },
                })
                .collect();
            Case {
                seed,
                truth: name(right.unwrap_or(5)),
                said,
            }
        };
        let cases: Vec<Case> = (0..12_000).map(&mut case).collect();
        let trained = fit(&cases, (10..22).map(|k: u8| k.to_string()).collect());
        let found: &Vec<f64> = &trained.head.weight.values().copied().collect();
        assert!(
            found.iter().zip(&truth).all(|(f, t)| (f - t).abs() < 0.15),
            "{found:?}"
        );
        let fresh: Vec<Case> = (12_000..15_000).map(&mut case).collect();
        let holds = |c: &&Case| {
            let claimed = c.claimed(&c.probabilities(found));
            let posterior = Posterior::of(claimed, trained.head.conformal);
            let truth = c.truth.as_deref().map(known);
            posterior
                .conformal()
                .iter()
                .any(|(names, _)| *names == truth)
        };
        let held = fresh.iter().filter(holds).count();
        assert!((2790..=2910).contains(&held), "95 % of 3,000: {held}");
        assert_eq!(trained.logs, [6000, 6000, 0]);
    }
}
