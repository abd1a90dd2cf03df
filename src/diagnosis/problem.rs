//! What a diagnosis asks of a log, whatever the machine: [`crate::diagnosis::tip`] and [`crate::diagnosis::rig`] answer it.

use crate::diagnosis::verdict::{Claim, Feature, Head, Posterior, Verdict};
use crate::diagnosis::{Candidates, Scored};

/// A log with everything that sets of effects are fitted to it and judged by.
pub trait Problem: Sized {
    /// A fitted set of effects.
    type Set: Scored + Clone;

    /// The nominal model, recalibrated.
    fn nominal(&self) -> &Self::Set;
    /// Every single effect, the best first, and the promising pairs.
    fn singles_and_pairs(&self) -> [Vec<Self::Set>; 2];
    /// The promising extensions of the best pair by one effect; none if it leaves too little for another.
    fn triples(&self, pair: &Self::Set) -> Vec<Self::Set>;
    /// The pairs within triples, of which a triple is claimed for what each effect adds to the other two.
    fn parts(&self, found: &Candidates<Self::Set>, triples: &[Self::Set]) -> Vec<Self::Set>;

    /// The weights of the features of a statement.
    fn head() -> &'static Head;
    /// Predictive density that a set lacks, with a surcharge for each effect; the best set has the least.
    fn lack(&self, set: &Self::Set) -> f64;
    /// Features of every statement: density of the left-out blocks.
    fn density(&self, set: &Self::Set) -> Vec<Feature>;
    /// Features of the statement that a set explains the log.
    fn of_set(&self, found: &Candidates<Self::Set>, set: &Self::Set) -> Vec<Feature>;
    /// Features of the statement that the nominal model does.
    fn of_none(&self) -> Vec<Feature>;
    /// Features of the statement that no set does; `best` is the best of them.
    fn of_unknown(&self, found: &Candidates<Self::Set>, best: &Self::Set) -> Vec<Feature>;
    /// The effects of the best set, in the order in which their features `form_EFFECT` are summed. They are 1 for `unknown`: a right effect
    /// whose law has another form leaves something too, more for some effects than for others.
    fn forms(best: &Self::Set) -> Vec<&'static str> {
        best.names().to_vec()
    }
    /// What may be claimed of a set.
    fn claim(&self, found: &Candidates<Self::Set>, set: &Self::Set) -> Claim;

    /// Pairs of effects that the log cannot tell apart at all.
    fn alike(&self) -> Vec<[&'static str; 2]> {
        vec![]
    }
    /// Single effects that could stand for any effect of these.
    fn stand_ins(&self, _: &Candidates<Self::Set>, _: &[&'static str]) -> Vec<&'static str> {
        vec![]
    }
}

/// A problem whose diagnosis is written as a document.
pub trait Documented: Problem {
    /// What is written of the log.
    type Document;

    /// The document.
    fn document(&self, judged: &Judged<Self>) -> Self::Document;
}

/// The fitted sets, the probabilities of all statements, and the verdict.
pub struct Judged<P: Problem> {
    /// All sets.
    pub found: Candidates<P::Set>,
    /// The probabilities.
    pub posterior: Posterior,
    /// The verdict.
    pub verdict: Verdict,
}

impl<P: Problem> Judged<P> {
    /// The verdict's set.
    pub fn chosen(&self) -> &P::Set {
        let chosen = self.found.set(&self.verdict.names);
        chosen.unwrap_or(&self.found.nominal)
    }
}
