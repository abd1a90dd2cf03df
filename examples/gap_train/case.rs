//! What training keeps of a log: the true statement and the features of all.

use super::rig;
use super::unit::Unit;
use retroflex::diagnosis;
use retroflex::diagnosis::tip::features::statements;
use retroflex::diagnosis::tip::observed::Observed;
use retroflex::diagnosis::tip::observed::refuse::ObserveError;
use retroflex::diagnosis::tip::rig::Rig;
use retroflex::diagnosis::tip::search::search;
use retroflex::diagnosis::verdict::posterior::{Claim, Said as SaidOf, Statement, ranked};
use retroflex::model::effects::catalogue;
use serde::{Deserialize, Serialize};

/// One statement of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// Names of the set, or `None` for `unknown`.
    pub names: Option<Vec<String>>,
    /// Its features.
    pub features: Vec<f64>,
    /// What may be claimed of it.
    pub claim: Claim<Vec<String>>,
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
    /// The case of a machine with these effects and the statements about its log.
    pub fn new(seed: u64, truth: Option<&[&str]>, statements: &[Statement]) -> Self {
        let owned = |names: &[&str]| {
            names
                .iter()
                .map(|n| (*n).to_owned())
                .collect::<Vec<String>>()
        };
        let said = |s: &Statement| Said {
            names: s.names.as_deref().map(owned),
            features: s.features.clone(),
            claim: Claim {
                names: s.claim.names.as_deref().map(owned),
                unexplained: s.claim.unexplained,
            },
        };
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
        let found = search(&log, &catalogue(), &unit.lines);
        Ok(Self::new(
            seed,
            unit.names.as_deref(),
            &statements(&log, &found),
        ))
    }

    /// Searches the log of a random rig.
    pub fn of_rig(seed: u64) -> Self {
        let rig = rig::draw(seed);
        let searched = diagnosis::rig::diagnose::search(&rig.map, &rig.signals, seed);
        Self::new(
            seed,
            rig.truth.as_deref(),
            &searched.map_or(vec![], |s| s.statements),
        )
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
    pub fn claimed(&self, p: &[f64]) -> Vec<SaidOf<Vec<String>>> {
        let of = |(s, p): (&Said, &f64)| match s.names {
            Some(_) => s.claim.clone().said(*p),
            None => vec![(None, *p)],
        };
        ranked(self.said.iter().zip(p).flat_map(of))
    }

    /// Features of all statements.
    pub fn features(&self) -> impl Iterator<Item = &[f64]> {
        self.said.iter().map(|s| s.features.as_slice())
    }
}
