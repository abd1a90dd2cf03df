//! A diagnosis saved as TOML.

use crate::diagnosis::tip::fit::{Candidate, best_predicting};
use crate::diagnosis::tip::model::LAG_MAX_S;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::{Diagnosed, confused_with};
use crate::model::effects::{Effect, MODE_PARAMS, Param, by_name, catalogue};
use crate::model::{DescribedMachine, Geometry, Line, RestReadings, lines, nominal_theta};
use crate::primitives::{Check, Checker};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Part of a range by which the digits of a number that was written by hand may be beyond it.
const ROUNDING: f64 = 1e-5;

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
    let value = |p: &Param| {
        saved
            .params
            .get(&key(p))
            .map_or(p.start, |v| rounded(p, *v))
    };
    Some(effect.params().iter().map(value).collect())
}

/// A value that only its last digits put beyond the limits, moved onto them.
fn rounded(p: &Param, value: f64) -> f64 {
    let within = value.clamp(p.low, p.high);
    let is_near = (value - within).abs() <= ROUNDING * (p.high - p.low);
    if is_near { within } else { value }
}

impl SavedEffect {
    /// Reports what the catalogue does not have, what is missing, and values that no machine has. `at` is the key of this effect.
    fn check(&self, at: &str, to: &mut Checker) {
        let Some(e) = by_name(&self.name) else {
            let problem = format!("effect `{}` is not in the catalogue", self.name);
            return to.refuse(&format!("{at}.name"), problem, AGAIN);
        };
        let keys: Vec<String> = e.params().iter().map(key).collect();
        let at = |key: &str| format!("{at}.params.{key}");
        if let Some(stray) = self.params.keys().find(|k| !keys.contains(k)) {
            let (name, keys) = (&self.name, keys.join(", "));
            let problem = format!("effect `{name}` has no such parameter; it has {keys}");
            to.refuse(&at(stray), problem, AGAIN);
        }
        // a file that is older than the modes has none
        let required = e.params().len() - e.modes() * MODE_PARAMS;
        for (n, (p, key)) in e.params().iter().zip(&keys).enumerate() {
            match self.params.get(key) {
                Some(value) => to
                    .at(&at(key))
                    .range(rounded(p, *value), p.low..=p.high, p.unit)
                    .hint(AGAIN),
                None if n < required => to.refuse(&at(key), "is missing".to_owned(), AGAIN),
                None => {}
            }
        }
    }
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
            rest: Some(log.segments[0].rest),
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
        let forecast = self.forecast.iter().map(|f| ("forecast.effect", &f.effect));
        for (at, effects) in [("effect", &self.effect)].into_iter().chain(forecast) {
            for (i, effect) in effects.iter().enumerate() {
                let at = format!("{at}.{i}");
                let is_first = effects[..i].iter().all(|other| other.name != effect.name);
                to.at(&format!("{at}.name"))
                    .holds(is_first, "this effect is stated twice")
                    .hint(AGAIN);
                effect.check(&at, to);
            }
        }
        for name in self.equivalent.iter().flatten() {
            let problem = format!("effect `{name}` is not in the catalogue");
            to.at("equivalent")
                .holds(by_name(name).is_some(), &problem)
                .hint(AGAIN);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::Invalid;

    const GAINS: SavedGains = SavedGains {
        k_epsilon: [2.2; 3],
        k_lambda_mm: [0.9; 3],
        lag_s: 0.02,
    };

    fn model(effect: Vec<SavedEffect>) -> SavedModel {
        SavedModel {
            schema: 1,
            source: "log.csv".to_owned(),
            equivalent: Vec::new(),
            nominal: GAINS,
            with_effects: GAINS,
            effect,
            rest: None,
            forecast: None,
        }
    }

    fn checked(model: &SavedModel) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        model.check(&mut checker);
        checker.done()
    }

    /// An effect with each parameter at `value`.
    fn at(e: &dyn Effect, value: fn(&Param) -> f64) -> SavedEffect {
        SavedEffect {
            name: e.name().to_owned(),
            params: e.params().iter().map(|p| (key(p), value(p))).collect(),
        }
    }

    /// The key at which a model with this effect is refused, as an effect of the verdict and as one of the forecast.
    fn refused(effect: &SavedEffect) -> Invalid {
        let verdict = checked(&model(vec![effect.clone()])).unwrap_err();
        let forecast = SavedForecast {
            gains: GAINS,
            effect: vec![effect.clone()],
        };
        let forecast = checked(&SavedModel {
            forecast: Some(forecast),
            ..model(Vec::new())
        })
        .unwrap_err();
        assert_eq!(forecast.key, format!("forecast.{}", verdict.key));
        assert_eq!(forecast.problem, verdict.problem);
        verdict
    }

    #[test]
    fn every_effect_is_read_back_at_its_limits() {
        let limits: [fn(&Param) -> f64; 2] = [|p| p.low, |p| p.high];
        for limit in limits {
            let effects = catalogue().iter().map(|e| at(*e, limit)).collect();
            let text = toml::to_string_pretty(&model(effects)).unwrap();
            let again: SavedModel = toml::from_str(&text).unwrap();
            assert_eq!(checked(&again), Ok(()));
            for e in catalogue() {
                let limits: Vec<f64> = e.params().iter().map(limit).collect();
                assert_eq!(again.params_of(*e), Some(limits), "{}", e.name());
            }
        }
    }

    #[test]
    fn what_no_machine_has_is_refused_with_its_key() {
        for e in catalogue() {
            let good = at(*e, |p| p.start);
            assert_eq!(checked(&model(vec![good.clone()])), Ok(()), "{}", e.name());
            let required = e.params().len() - e.modes() * MODE_PARAMS;
            for (n, p) in e.params().iter().enumerate() {
                let name = format!("effect.0.params.{}", key(p));
                let range = p.high - p.low;
                for bad in [
                    p.low - 0.001 * range,
                    p.high + 0.001 * range,
                    1e10,
                    f64::NAN,
                    f64::NEG_INFINITY,
                ] {
                    let mut effect = good.clone();
                    effect.params.insert(key(p), bad);
                    let why = refused(&effect);
                    assert_eq!(why.key, name);
                    let limits = format!("is outside {} to {}", p.low, p.high);
                    assert!(why.problem.contains(&limits), "{why}");
                }
                let mut effect = good.clone();
                effect.params.insert(key(p), p.high + 1e-6 * range);
                let near = model(vec![effect.clone()]);
                assert_eq!(checked(&near), Ok(()), "{name}");
                assert_eq!(near.params_of(*e).unwrap()[n], p.high, "{name}");
                effect.params.remove(&key(p));
                if n < required {
                    let why = refused(&effect);
                    assert_eq!(
                        (why.key.as_str(), why.problem.as_str()),
                        (name.as_str(), "is missing")
                    );
                } else {
                    assert_eq!(checked(&model(vec![effect])), Ok(()), "{name}");
                }
            }
            let mut effect = good.clone();
            effect.params.insert("colour".to_owned(), 0.0);
            assert_eq!(refused(&effect).key, "effect.0.params.colour");
        }
        let twice = vec![at(catalogue()[0], |p| p.start); 2];
        assert_eq!(checked(&model(twice)).unwrap_err().key, "effect.1.name");
        let ghost = SavedEffect {
            name: "ghost".to_owned(),
            params: BTreeMap::new(),
        };
        assert_eq!(refused(&ghost).key, "effect.0.name");
    }

    #[test]
    fn gains_that_no_line_has_are_refused_with_their_key() {
        type Spoil = fn(&mut SavedGains, f64);
        let spoil: [(&str, Spoil); 3] = [
            ("k_epsilon.1", |g, bad| g.k_epsilon[1] = bad),
            ("k_lambda_mm.2", |g, bad| g.k_lambda_mm[2] = bad),
            ("lag_s", |g, bad| g.lag_s = bad),
        ];
        for (key, spoil) in spoil {
            for bad in [-0.1, 10.1, 1e10, f64::NAN] {
                let mut gains = GAINS;
                spoil(&mut gains, bad);
                for (table, spoilt) in [
                    (
                        "nominal",
                        SavedModel {
                            nominal: gains.clone(),
                            ..model(Vec::new())
                        },
                    ),
                    (
                        "with_effects",
                        SavedModel {
                            with_effects: gains.clone(),
                            ..model(Vec::new())
                        },
                    ),
                    (
                        "forecast.gains",
                        SavedModel {
                            forecast: Some(SavedForecast {
                                gains: gains.clone(),
                                effect: Vec::new(),
                            }),
                            ..model(Vec::new())
                        },
                    ),
                ] {
                    let why = checked(&spoilt).unwrap_err();
                    assert_eq!(why.key, format!("{table}.{key}"));
                }
            }
        }
    }
}
