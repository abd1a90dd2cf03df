//! What training keeps of a log: the true statement and the features of all.

use crate::diagnosis::exam::question::Content;
use crate::diagnosis::observe::Observed;
use crate::diagnosis::posterior::{FEATURES, Features, statements};
use crate::diagnosis::refuse::ObserveError;
use crate::diagnosis::rig::Rig;
use crate::diagnosis::search::search;
use crate::diagnosis::train::unit::Unit;
use crate::model::effects::catalogue;
use serde::{Deserialize, Serialize};

/// One statement of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Said {
    /// Names of the set, or `None` for `unknown`.
    pub names: Option<Vec<String>>,
    /// Its features.
    pub features: [f64; FEATURES],
}

/// The log of one unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Seed of the unit.
    pub seed: u64,
    /// Names of the true effects, or `None` for one that the catalogue lacks.
    pub truth: Option<Vec<String>>,
    /// All statements.
    pub said: Vec<Said>,
}

impl Case {
    /// Searches the log of a unit.
    ///
    /// # Errors
    /// [`ObserveError`] for a log that cannot be diagnosed.
    pub fn new(seed: u64, unit: &Unit) -> Result<Self, ObserveError> {
        let log = Observed::new(&unit.log, &Rig::default())?;
        let found = search(&log, &catalogue(), &unit.lines);
        let owned = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<String>>();
        let said =
            |s: &crate::diagnosis::posterior::Statement<'_>| Said { names: s.set.map(|c| owned(&c.names)), features: s.features.into() };
        let truth = (unit.content != Content::Outside).then(|| owned(&unit.names));
        Ok(Self { seed, truth, said: statements(&log, &found).iter().map(said).collect() })
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

    /// Features of all statements.
    pub fn features(&self) -> impl Iterator<Item = Features> + '_ {
        self.said.iter().map(|s| Features::from(s.features))
    }
}
