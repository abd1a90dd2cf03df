//! Which set of effects explains the log: every single effect, the pairs that may explain more, and triples where a pair leaves something.
//!
//! [`mod@crate::diagnosis::verdict::decide`] checks whether a set needs all its members.

use crate::diagnosis::{Candidates, Scored};

/// A log with everything that sets of effects are fitted to it by.
pub trait Search: Sized {
    /// A fitted set of effects.
    type Set: Scored + Clone;
    /// What the fit of a single effect leaves, beside its set, for the choice of the pairs.
    type Trace;

    /// The nominal model, recalibrated.
    fn nominal(&self) -> &Self::Set;
    /// Every single effect.
    fn singles(&self) -> Vec<(Self::Set, Self::Trace)>;
    /// The promising pairs; the singles are sorted, the best first.
    fn pairs(&self, singles: &[(Self::Set, Self::Trace)]) -> Vec<Self::Set>;
    /// The promising extensions of the best pair by one effect; none if it leaves too little for another.
    fn triples(&self, pair: &Self::Set) -> Vec<Self::Set>;
    /// The pairs within triples, of which a triple is claimed for what each effect adds to the other two.
    fn parts(&self, found: &Candidates<Self::Set>, triples: &[Self::Set]) -> Vec<Self::Set>;
}

/// Fits and scores the sets.
pub fn search<P: Search>(problem: &P) -> Candidates<P::Set> {
    let mut singles = problem.singles();
    singles.sort_by(|a, b| a.0.energy().total_cmp(&b.0.energy()));
    let mut found = Candidates {
        nominal: problem.nominal().clone(),
        singles: vec![],
        larger: vec![],
    };
    found.add(problem.pairs(&singles));
    found.singles = singles.into_iter().map(|(set, _)| set).collect();
    if let Some(triples) = found.larger.first().map(|pair| problem.triples(pair)) {
        let parts = problem.parts(&found, &triples);
        found.add(triples.into_iter().chain(parts));
    }
    found
}
