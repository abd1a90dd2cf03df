//! A diagnosis saved as TOML.

use crate::diagnosis::tip::fit::{Candidate, best_predicting};
use crate::diagnosis::tip::model::LAG_MAX_S;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{Diagnosed, confused_with};
use crate::model::effects::{Effect, Param, by_name, catalogue};
use crate::model::{DescribedMachine, Geometry, Line, RestReadings, lines, nominal_theta};
use crate::primitives::{Check, Checker};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Advice for every value that is out of range.
const AGAIN: &str = "diagnose the log again with --save";

/// Identified nominal gains.
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

/// An effect with its parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedEffect {
    /// As in the catalogue.
    pub name: String,
    /// Values by parameter name, `name` or `name@channel`.
    pub params: BTreeMap<String, f64>,
}

/// A saved model: the recalibrated nominal model, and the model with effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedModel {
    /// Version of this file.
    pub schema: u32,
    /// Log it was made from.
    pub source: String,
    /// Groups of effects that the log could not separate, by name.
    #[serde(default)]
    pub equivalent: Vec<Vec<String>>,
    /// Recalibrated nominal model.
    pub nominal: SavedGains,
    /// Gains identified together with the effects.
    pub with_effects: SavedGains,
    /// Effects; empty if the verdict is `none`.
    #[serde(default)]
    pub effect: Vec<SavedEffect>,
    /// Readings at rest.
    pub rest: Option<RestReadings>,
    /// The model that predicts best, for a feedforward or a simulation; it may have more effects than the verdict.
    pub forecast: Option<SavedForecast>,
}

/// Gains and effects of a forecast.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedForecast {
    /// Gains identified together with the effects.
    pub gains: SavedGains,
    /// Effects.
    #[serde(default)]
    pub effect: Vec<SavedEffect>,
}

impl SavedGains {
    /// The gains in a vector of parameters.
    pub fn new(theta: &[f64]) -> Self {
        let lines = lines(theta);
        Self {
            k_epsilon: lines.map(|l| l.k_epsilon),
            k_lambda_mm: lines.map(|l| l.k_lambda_mm),
            lag_s: theta[6],
        }
    }

    /// The gains as lines.
    pub fn lines(&self) -> [Line; 3] {
        Line::each(self.k_epsilon, self.k_lambda_mm)
    }
}

fn key(p: &Param) -> String {
    match p.channel {
        0 => p.name.to_owned(),
        channel => format!("{}@{channel}", p.name),
    }
}

/// The effects of a candidate with their values.
fn saved_effects(from: &Candidate) -> Vec<SavedEffect> {
    let one = |(e, p): (&'static dyn Effect, &[f64])| SavedEffect {
        name: e.name().to_owned(),
        params: e.params().iter().map(key).zip(p.iter().copied()).collect(),
    };
    from.model.each(&from.theta).map(one).collect()
}

/// Parameters of an effect among saved ones, in catalogue order.
fn params_of(saved: &[SavedEffect], effect: &dyn Effect) -> Option<Vec<f64>> {
    let saved = saved.iter().find(|s| s.name == effect.name())?;
    let value = |p: &Param| saved.params.get(&key(p)).copied().unwrap_or(p.start);
    Some(effect.params().iter().map(value).collect())
}

impl SavedModel {
    /// The model of a diagnosis of the log `source`.
    pub fn new(source: &str, done: &Diagnosed) -> Self {
        let owned = |group: &Vec<&'static str>| group.iter().map(|n| (*n).to_owned()).collect();
        Self {
            schema: 1,
            source: source.to_owned(),
            nominal: SavedGains::new(&done.found.nominal.theta),
            with_effects: SavedGains::new(&done.chosen.theta),
            equivalent: done.document.verdict.equivalent.iter().map(owned).collect(),
            effect: saved_effects(&done.chosen),
            rest: None,
            forecast: None,
        }
    }

    /// Adds the model that predicts the log best.
    #[must_use]
    pub fn with_forecast(self, log: &Observed, done: &Diagnosed) -> Self {
        let best = best_predicting(log, &done.found.nominal, &done.chosen);
        Self {
            rest: Some(log.rest()),
            forecast: Some(SavedForecast {
                gains: SavedGains::new(&best.theta),
                effect: saved_effects(&best),
            }),
            ..self
        }
    }

    /// The machine that this model describes: the forecast if there is one, otherwise the verdict's set.
    pub fn described(&self, geometry: Geometry) -> DescribedMachine {
        let (gains, effects) = match &self.forecast {
            Some(forecast) => (&forecast.gains, &forecast.effect),
            None => (&self.with_effects, &self.effect),
        };
        let readings = |r: RestReadings| RestReadings {
            up: r.up.normalize(),
            ..r
        };
        let rest = self.rest.map_or_else(RestReadings::default, readings);
        let cause = |e: &&'static dyn Effect| Some((*e, params_of(effects, *e)?));
        DescribedMachine::new(
            geometry,
            rest,
            &nominal_theta(&gains.lines(), gains.lag_s),
            catalogue().iter().filter_map(cause).collect(),
        )
    }

    /// Parameters of an effect in catalogue order; `None` if the model does not have it.
    pub fn params_of(&self, effect: &dyn Effect) -> Option<Vec<f64>> {
        params_of(&self.effect, effect)
    }

    /// Names that another log should separate: the equivalent groups or, without any, the effects and those they are
    /// confusable with.
    pub fn in_question(&self) -> Vec<String> {
        if self.equivalent.iter().any(|g| g.len() > 1) {
            return self.equivalent.concat();
        }
        let names = self.effect.iter().map(|e| e.name.clone());
        let similar = self.effect.iter().flat_map(|e| confused_with(&e.name));
        names.chain(similar.map(|n| (*n).to_owned())).collect()
    }

    /// The effects of the verdict, and those of the forecast.
    fn all_effects(&self) -> impl Iterator<Item = &SavedEffect> {
        let forecast = self.forecast.iter().flat_map(|f| &f.effect);
        self.effect.iter().chain(forecast)
    }

    /// The first effect or parameter that the catalogue does not have, as a problem; `None` if there is none.
    pub fn unknown_names(&self) -> Option<String> {
        for s in self.all_effects() {
            let Some(e) = by_name(&s.name) else {
                return Some(format!("effect `{}` is not in the catalogue", s.name));
            };
            let keys: Vec<String> = e.params().iter().map(key).collect();
            if let Some(stray) = s.params.keys().find(|k| !keys.contains(k)) {
                let (has, keys) = (format!("effect `{}` has no", s.name), keys.join(", "));
                return Some(format!("{has} parameter `{stray}`; it has {keys}"));
            }
        }
        let mut grouped = self.equivalent.iter().flatten();
        let stray = grouped.find(|n| by_name(n).is_none());
        stray.map(|n| format!("equivalent: effect `{n}` is not in the catalogue"))
    }
}

impl Check for SavedModel {
    const REMEDY: &'static str = AGAIN;

    fn check(&self, to: &mut Checker) {
        to.at("schema")
            .range(f64::from(self.schema), 1.0..=1.0, "")
            .hint("made by another version: diagnose the log again with --save");
        let forecast = self.forecast.as_ref().map(|f| ("forecast.gains", &f.gains));
        let gains = [
            ("nominal", &self.nominal),
            ("with_effects", &self.with_effects),
        ];
        for (at, g) in gains.into_iter().chain(forecast) {
            let arrays = [
                ("k_epsilon", &g.k_epsilon, 10.0, ""),
                ("k_lambda_mm", &g.k_lambda_mm, 3.0, "mm"),
            ];
            for (key, values, high, unit) in arrays {
                let at = format!("{at}.{key}");
                to.each(&at, values, &(0.0..=high), unit, AGAIN);
            }
            let at = to.at(&format!("{at}.lag_s"));
            at.range(g.lag_s, 0.0..=LAG_MAX_S + 1e-9, "s").hint(AGAIN);
        }
        if let Some(rest) = &self.rest {
            let within = |to: &mut Checker, key: &str, value: &Vector3<f64>, most: f64, unit| {
                let at = format!("rest.{key}");
                to.each(&at, value.as_slice(), &(-most..=most), unit, AGAIN);
            };
            within(to, "up", &rest.up, 1.0, "");
            to.at("rest.up")
                .holds(rest.up.norm() > 0.5, "the direction of up has no length")
                .hint(AGAIN);
            within(to, "field_ut", &rest.field_ut, 1000.0, "µT");
            within(to, "gyro_bias_rad_s", &rest.gyro_bias_rad_s, 1.0, "rad/s");
        }
        for (i, e) in self.all_effects().enumerate() {
            let finite = e.params.values().all(|v| v.is_finite());
            to.at(&format!("effect.{i}.params"))
                .holds(finite, "a parameter is not a finite number")
                .hint(AGAIN);
        }
    }
}
