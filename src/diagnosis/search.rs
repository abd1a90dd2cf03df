//! Which set of effects explains the log: every single effect, the pairs that may explain more, and triples where a pair leaves something.
//!
//! [`mod@crate::diagnosis::verdict::decide`] checks whether a set needs all its members.

use crate::diagnosis::{Candidates, Problem, Scored};

/// Fits and scores the sets.
pub fn search<P: Problem>(problem: &P) -> Candidates<P::Set> {
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
