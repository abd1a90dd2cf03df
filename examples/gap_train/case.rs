//! What training keeps of a log: the true statement and the features of all.

use super::rig;
use super::unit::Unit;
use retroflex::diagnosis::rig::RigProblem;
use retroflex::diagnosis::tip::observed::{ObserveError, Observed};
use retroflex::diagnosis::tip::{Rig, TipProblem};
use retroflex::diagnosis::verdict::Posterior;
use retroflex::diagnosis::verdict::{posterior, probabilities};
use retroflex::diagnosis::{Problem, search, statements};
use retroflex::model::effects::catalogue;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// What may be claimed of a set, as a file has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Claim {
    /// The effects that explain enough; `None` for a set that says nothing.
    pub names: Option<Vec<String>>,
    /// Part of the probability that goes to `unknown`.
    pub unexplained: f64,
}

impl Claim {
    /// The claim with the names that the program has.
    pub fn known(&self) -> posterior::Claim {
        posterior::Claim {
            names: self.names.as_deref().map(known),
            unexplained: self.unexplained,
        }
    }
}

/// These names for as long as the program runs, one copy of each.
pub fn known(names: &[String]) -> Vec<&'static str> {
    static KNOWN: Mutex<BTreeSet<&str>> = Mutex::new(BTreeSet::new());
    let mut all = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let mut one = |name: &String| {
        let new = || &*name.clone().leak();
        let name = all.get(name.as_str()).copied().unwrap_or_else(new);
        all.insert(name);
        name
    };
    names.iter().map(&mut one).collect()
}

/// One statement of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// Names of the set, or `None` for `unknown`.
    pub names: Option<Vec<String>>,
    /// Its features, in the order of their names.
    #[serde(rename = "features_by_name")]
    pub features: Vec<f64>,
    /// What may be claimed of it.
    pub claim: Claim,
}

/// A log of training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Seed of the machine.
    pub seed: u64,
    /// Names of the true effects, or `None` with one that the catalogue lacks.
    pub truth: Option<Vec<String>>,
    /// All statements.
    pub said: Vec<Said>,
}

impl Case {
    /// The case of a machine with these effects and the log of the problem.
    fn new<P: Problem>(seed: u64, truth: Option<&[&str]>, problem: Option<&P>) -> Self {
        let owned = |names: &[&str]| {
            names
                .iter()
                .map(|n| (*n).to_owned())
                .collect::<Vec<String>>()
        };
        let weights = &P::head().weight;
        let value = |s: &posterior::Statement, name: &String| {
            let stray = s.features.iter().find(|(n, _)| !weights.contains_key(n));
            assert!(
                stray.is_none(),
                "posterior.toml lacks {stray:?}: add it with 0"
            );
            let known = s.features.iter().find(|(known, _)| known == name);
            known.map_or(0.0, |(_, value)| *value)
        };
        let said = |s: &posterior::Statement| Said {
            names: s.names.as_deref().map(owned),
            features: weights.keys().map(|n| value(s, n)).collect(),
            claim: Claim {
                names: s.claim.names.as_deref().map(owned),
                unexplained: s.claim.unexplained,
            },
        };
        let statements = problem.map_or(vec![], |p| statements(p, &search(p)));
        Self {
            seed,
            truth: truth.map(owned),
            said: statements.iter().map(said).collect(),
        }
    }

    /// Searches the log of a unit.
    ///
    /// # Errors
    /// [`ObserveError`] for a log that cannot be diagnosed.
    pub fn of_tip(seed: u64, unit: &Unit) -> Result<Self, ObserveError> {
        let log = Observed::new(&unit.log, &Rig::default())?;
        let problem = TipProblem::new(&log, catalogue(), &unit.lines, seed);
        Ok(Self::new(seed, unit.names.as_deref(), Some(&problem)))
    }

    /// Searches the log of a random rig.
    pub fn of_rig(seed: u64) -> Self {
        let rig = rig::draw(seed);
        let problem = RigProblem::new(&rig.map, std::slice::from_ref(&rig.signals), seed);
        Self::new(seed, rig.truth.as_deref(), problem.as_ref())
    }

    /// Index of the true statement; `None` if the search has not fitted the true set.
    pub fn right(&self) -> Option<usize> {
        let sorted = |names: &Option<Vec<String>>| {
            names.clone().map(|mut n| {
                n.sort();
                n
            })
        };
        let truth = sorted(&self.truth);
        self.said.iter().position(|s| sorted(&s.names) == truth)
    }

    /// What these probabilities of the statements claim, the most probable first.
    pub fn claimed(&self, p: &[f64]) -> Vec<posterior::Said> {
        let of = |(s, p): (&Said, &f64)| match s.names {
            Some(_) => s.claim.known().said(*p),
            None => vec![(None, *p)],
        };
        Posterior::of(self.said.iter().zip(p).flat_map(of), 1.0).ranked
    }

    /// Features of all statements.
    pub fn features(&self) -> impl Iterator<Item = &[f64]> {
        self.said.iter().map(|s| s.features.as_slice())
    }

    /// Probabilities of all statements with these weights.
    pub fn probabilities(&self, weights: &[f64]) -> Vec<f64> {
        let score = |x: &[f64]| x.iter().zip(weights).map(|(x, w)| x * w).sum();
        probabilities(&self.features().map(score).collect::<Vec<f64>>())
    }
}
