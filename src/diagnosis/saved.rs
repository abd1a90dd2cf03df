//! A diagnosis kept as TOML, and its check on a fresh log of the same unit.

use crate::diagnosis::chain::{LAG_MAX_S, NOMINAL, run};
use crate::diagnosis::decide::floor;
use crate::diagnosis::observe::Observed;
use crate::diagnosis::search::{Candidate, Found, model_of, score};
use crate::diagnosis::sense::sense;
use crate::model::effects::Effect;
use crate::primitives::{check::Checker, parameters::Check};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Nominal gains as they were re-identified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedGains {
    /// Extension gains k_ε.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths k_λ, mm.
    pub k_lambda_mm: [f64; 3],
    /// Mechanical lag τ₀, s.
    pub lag_s: f64,
}

/// One effect with its parameters by name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedEffect {
    /// Effect name.
    pub name: String,
    /// Parameters in the order of the catalogue, `name@channel` → value.
    pub params: BTreeMap<String, f64>,
}

/// A saved model: the recalibrated nominal one, and the one with effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedModel {
    /// Version of this file.
    pub schema: u32,
    /// Log it was made from.
    pub source: String,
    /// Groups of effects that the log could not tell apart, by name.
    #[serde(default)]
    pub equivalent: Vec<Vec<String>>,
    /// Recalibrated nominal model.
    pub nominal: SavedGains,
    /// Gains re-identified together with the effects.
    pub with_effects: SavedGains,
    /// The effects; empty if the verdict was none.
    #[serde(default)]
    pub effect: Vec<SavedEffect>,
}

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Checked {
    /// RMSE of the recalibrated nominal model, degrees.
    pub before_deg: f64,
    /// RMSE with its effects, degrees.
    pub after_deg: f64,
    /// Part of the gap that the effects close.
    pub closed: f64,
}

fn gains(theta: &[f64]) -> SavedGains {
    let k = |i: usize| theta[i].exp() - 1.0;
    SavedGains { k_epsilon: [k(0), k(1), k(2)], k_lambda_mm: [theta[3], theta[4], theta[5]], lag_s: theta[6] }
}

fn theta(g: &SavedGains) -> Vec<f64> {
    let mut t: Vec<f64> = g.k_epsilon.iter().map(|k| (1.0 + k).ln()).collect();
    t.extend(g.k_lambda_mm);
    t.push(g.lag_s);
    t
}

fn key(p: &crate::model::effects::Param) -> String {
    if p.channel == 0 { p.name.to_owned() } else { format!("{}@{}", p.name, p.channel) }
}

impl SavedModel {
    /// From a diagnosis.
    #[must_use]
    pub fn new(source: &str, catalogue: &[Box<dyn Effect>], found: &Found, chosen: &Candidate, equivalent: &[Vec<&'static str>]) -> Self {
        let model = model_of(catalogue, &chosen.names);
        let effect = model
            .each(&chosen.fitted.theta)
            .map(|(e, p)| SavedEffect { name: e.name().to_owned(), params: e.params().iter().map(key).zip(p.iter().copied()).collect() })
            .collect();
        Self {
            schema: 1,
            source: source.to_owned(),
            nominal: gains(&found.nominal.fitted.theta),
            with_effects: gains(&chosen.fitted.theta),
            equivalent: equivalent.iter().map(|g| g.iter().map(|n| (*n).to_owned()).collect()).collect(),
            effect,
        }
    }

    /// Names of its effects.
    #[must_use]
    pub fn names(&self) -> Vec<&str> {
        self.effect.iter().map(|e| e.name.as_str()).collect()
    }

    /// Parameters of an effect in the order of the catalogue; `None` if the model has no such effect.
    #[must_use]
    pub fn params_of(&self, effect: &dyn Effect) -> Option<Vec<f64>> {
        let saved = self.effect.iter().find(|s| s.name == effect.name())?;
        Some(effect.params().iter().map(|p| saved.params.get(&key(p)).copied().unwrap_or(p.start)).collect())
    }

    /// What another log should tell apart: the groups, or else the effects and what they are taken for.
    #[must_use]
    pub fn in_question(&self) -> Vec<String> {
        if self.equivalent.iter().any(|g| g.len() > 1) {
            return self.equivalent.concat();
        }
        let mut out: Vec<String> = self.effect.iter().map(|e| e.name.clone()).collect();
        for e in self.effect.iter().filter_map(|s| crate::model::effects::by_name(&s.name)) {
            out.extend(e.info().confused_with.iter().map(|n| (*n).to_owned()));
        }
        out
    }

    /// Runs both models over a fresh log; only gravity, field and gyroscope bias (the base frame and
    /// the references) are solved anew.
    #[must_use]
    pub fn check_on(&self, log: &Observed, catalogue: &[Box<dyn Effect>]) -> Checked {
        let all = vec![1.0; log.bins.len()];
        let energy = |names: &[&str], theta: &[f64]| {
            let model = model_of(catalogue, names);
            score(log, sense(log, &model, theta, &run(log, &model, theta), &all).residual, &all).energy()
        };
        let before = energy(&[], &theta(&self.nominal));
        let mut full = theta(&self.with_effects);
        let names = self.names();
        for e in &model_of(catalogue, &names).effects {
            let saved = self.effect.iter().find(|s| s.name == e.name());
            full.extend(e.params().iter().map(|p| saved.and_then(|s| s.params.get(&key(p)).copied()).unwrap_or(p.start)));
        }
        debug_assert!(full.len() >= NOMINAL);
        let after = energy(&names, &full);
        let kinds = log.has.iter().filter(|&&h| h).count() as f64;
        Checked {
            before_deg: (before / kinds).sqrt(),
            after_deg: (after / kinds).sqrt(),
            closed: ((before - after) / (before - floor(log)).max(1e-9)).min(1.0),
        }
    }

    /// What the file must hold besides its form: effects and parameters that the catalogue knows.
    #[must_use]
    pub fn unknown_names(&self, catalogue: &[Box<dyn Effect>]) -> Option<String> {
        for s in &self.effect {
            let Some(e) = catalogue.iter().find(|e| e.name() == s.name) else {
                return Some(format!("effect `{}` is not in the catalogue", s.name));
            };
            let keys: Vec<String> = e.params().iter().map(key).collect();
            if let Some(stray) = s.params.keys().find(|k| !keys.contains(k)) {
                return Some(format!("effect `{}` has no parameter `{stray}`; it has {}", s.name, keys.join(", ")));
            }
        }
        if let Some(stray) = self.equivalent.iter().flatten().find(|n| !catalogue.iter().any(|e| e.name() == n.as_str())) {
            return Some(format!("equivalent: effect `{stray}` is not in the catalogue"));
        }
        None
    }
}

impl Check for SavedModel {
    fn check(&self, to: &mut Checker) {
        to.range("schema", f64::from(self.schema), 1.0..=1.0, "", "made by another version: diagnose the log again with --save");
        for (at, g) in [("nominal", &self.nominal), ("with_effects", &self.with_effects)] {
            to.ranges(&format!("{at}.k_epsilon"), &g.k_epsilon, 0.0..=10.0, "", "diagnose the log again with --save");
            to.ranges(&format!("{at}.k_lambda_mm"), &g.k_lambda_mm, 0.0..=3.0, "mm", "diagnose the log again with --save");
            to.range(&format!("{at}.lag_s"), g.lag_s, 0.0..=LAG_MAX_S + 1e-9, "s", "diagnose the log again with --save");
        }
        for (i, e) in self.effect.iter().enumerate() {
            let finite = e.params.values().all(|v| v.is_finite());
            to.holds(&format!("effect.{i}.params"), finite, "a parameter is not a finite number", "diagnose the log again with --save");
        }
    }
}
