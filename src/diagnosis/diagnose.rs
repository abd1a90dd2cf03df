//! A diagnosis: sets of effects are fitted, the statements about the log get probabilities, the most probable is the verdict.

use crate::diagnosis::verdict::{Posterior, decide, statements};
use crate::diagnosis::{Candidates, Judged, Problem, search};

/// A diagnosis and what it was made from.
pub struct Diagnosed<D, S> {
    /// The document.
    pub document: D,
    /// All sets.
    pub found: Candidates<S>,
    /// The verdict's set.
    pub chosen: S,
}

/// Diagnoses a log.
pub fn diagnose<P: Problem>(problem: &P) -> Diagnosed<P::Document, P::Set> {
    let found = search(problem);
    let alike = problem.alike();
    let posterior = Posterior::new(P::head(), statements(problem, &found)).shared(&alike);
    let verdict = decide(&posterior, &alike, |names| problem.stand_ins(&found, names));
    let judged = Judged {
        found,
        posterior,
        verdict,
    };
    Diagnosed {
        document: problem.document(&judged),
        chosen: judged.chosen().clone(),
        found: judged.found,
    }
}
