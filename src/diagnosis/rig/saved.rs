//! The diagnosed model of a rig, saved as TOML.

use crate::diagnosis::Diagnosed;
use crate::diagnosis::rig::document::Figures;
use crate::diagnosis::rig::operators::catalogue;
use crate::diagnosis::rig::{Document, Drive, MapFile, Member, Operator, RigProblem, Scale, Set};
use crate::primitives::{Check, Checker};
use serde::{Deserialize, Serialize};

/// Advice for every value that is out of range.
const AGAIN: &str = "diagnose the logs again with --map and --save";
/// Largest magnitude of a number.
const LARGEST: f64 = 1e19;
/// Least of a number that divides.
const LEAST: f64 = 1e-12;

/// A saved model: map, recalibrated nominal model, and the model with effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedRig {
    /// Version of this file.
    pub schema: u32,
    /// Version of the program.
    pub version: String,
    /// Logs it was made from.
    pub source: String,
    /// Part of the gap that the effects close, and its 95 % interval; none without effects.
    pub closed: Option<f64>,
    /// The interval.
    pub closed_ci95: Option<[f64; 2]>,
    /// What the output moves per unit of each input, identified together with the effects.
    pub with_effects: Vec<f64>,
    /// Standard deviation of the output on the logs.
    pub spread: f64,
    /// RMSE on held-out blocks of the logs.
    pub gap: Figures,
    /// What the columns of the logs mean.
    pub map: MapFile,
    /// Recalibrated nominal model.
    pub nominal: Scale,
    /// Effects; empty if the verdict is `none`.
    #[serde(default)]
    pub effect: Vec<SavedOperator>,
}

/// An effect with its values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedOperator {
    /// As in the catalogue.
    pub name: String,
    /// Its nonlinear parameter; zero if it has none.
    pub value: f64,
    /// 95 % interval of that.
    pub ci95: [f64; 2],
    /// Size of each of its terms, in the unit of the output; none if the sizes are those of one log.
    pub sizes: Vec<f64>,
}

impl SavedRig {
    /// The model of a diagnosis of the logs `source`.
    pub fn new(source: String, problem: &RigProblem<'_>, done: &Diagnosed<Document, Set>) -> Self {
        let (scale, set) = (&problem.base.scale, &done.chosen);
        let fitted = &set.scores.coefficients[problem.logs.len()..];
        let (with_effects, mut sizes) = fitted.split_at(scale.weights.len());
        let whole = done.document.set.first();
        let effect = |m: &Member| {
            let own;
            (own, sizes) = sizes.split_at(m.columns.len());
            let own = if m.operator.is_state { &[] } else { own };
            SavedOperator {
                name: m.operator.name.to_owned(),
                value: m.eta,
                ci95: m.ci95,
                sizes: own.to_vec(),
            }
        };
        Self {
            schema: 1,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source,
            closed: whole.map(|entry| entry.closed),
            closed_ci95: whole.map(|entry| entry.closed_ci95),
            effect: set.members.iter().map(effect).collect(),
            with_effects: with_effects.to_vec(),
            spread: problem.variance().sqrt(),
            gap: done.document.gap.clone(),
            map: problem.map.clone(),
            nominal: scale.clone(),
        }
    }

    /// The effects with their operators; one that the catalogue of the rig does not have is missing.
    pub fn effects<'a>(&'a self) -> Vec<(Operator, &'a SavedOperator)> {
        let all = catalogue(self.map.nominal, self.map.is_clocked());
        let known = |e: &'a SavedOperator| Some((*all.iter().find(|o| o.name == e.name)?, e));
        self.effect.iter().filter_map(known).collect()
    }
}

impl Check for SavedRig {
    const REMEDY: &'static str = AGAIN;

    fn check(&self, to: &mut Checker) {
        to.at("schema")
            .range(f64::from(self.schema), 1.0..=1.0, "")
            .hint("made by another version: diagnose the logs again with --map and --save");
        self.map.check_within(to, "map.");
        let (inputs, n) = (self.map.inputs().len(), &self.nominal);
        let [frequency, damping] = n.swing.unwrap_or([1.0; 2]);
        for (key, weights) in [
            ("with_effects", &self.with_effects),
            ("nominal.weights", &n.weights),
        ] {
            to.each(key, weights, &(-LARGEST..=LARGEST), "", AGAIN);
            let enough = weights.len() == inputs;
            to.at(key)
                .holds(enough, "needs a number for each input")
                .hint(AGAIN);
        }
        for (key, value, least) in [
            ("spread", self.spread, LEAST),
            ("gap.recalibrated", self.gap.recalibrated, 0.0),
            ("gap.noise_floor", self.gap.noise_floor, 0.0),
            ("nominal.middle", n.middle, -LARGEST),
            ("nominal.half", n.half, LEAST),
            ("nominal.m_low", n.m_low, -LARGEST),
            ("nominal.m_range", n.m_range, LEAST),
            ("nominal.swing", frequency.min(damping), LEAST),
        ] {
            to.at(key).range(value, least..=LARGEST, "").hint(AGAIN);
        }
        // an operator has as many terms on any log
        let d = Drive {
            parts: vec![vec![0.0; 2]; inputs.saturating_sub(1)],
            v: vec![0.0, 1.0],
            m: vec![0.0, 1.0],
            m_range: 1.0,
            t: vec![0.0, 1.0],
            zero: 0.0,
        };
        let known = self.effects();
        let is_known = |e: &SavedOperator| known.iter().any(|(o, _)| o.name == e.name);
        let stray = self.effect.iter().find(|e| !is_known(e));
        let name = stray.map_or("", |e| &e.name);
        let problem = format!("`{name}` is no effect of a rig with this map");
        to.at("effect").holds(stray.is_none(), &problem).hint(AGAIN);
        for (i, (operator, e)) in known.iter().enumerate() {
            let at = |key: &str| format!("effect.{i}.{key}");
            let least = if operator.eta.is_empty() { 0.0 } else { LEAST };
            to.at(&at("value"))
                .range(e.value, least..=LARGEST, "")
                .hint(AGAIN);
            to.each(&at("sizes"), &e.sizes, &(-LARGEST..=LARGEST), "", AGAIN);
            let terms = (operator.columns)(&d, e.value).len();
            let terms = if operator.is_state { 0 } else { terms };
            let problem = format!("{} numbers, the effect has {terms} terms", e.sizes.len());
            to.at(&at("sizes"))
                .holds(e.sizes.len() == terms, &problem)
                .hint(AGAIN);
        }
    }
}
