//! A diagnosis: sets of effects are fitted, the statements about the log get probabilities, the most probable is the verdict.

use crate::diagnosis::verdict::{Claim, Posterior, Statement, decide};
use crate::diagnosis::{Candidates, Judged, Problem, Scored, search};

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

/// All statements about a log, with the features that their probabilities are made from: each set, the nominal model, `unknown`. The score of
/// a set rises with the predictive density of the left-out blocks and falls with its freedom.
pub fn statements<P: Problem>(problem: &P, found: &Candidates<P::Set>) -> Vec<Statement> {
    let (nominal, head) = (&found.nominal, P::head());
    let lack = |set: &P::Set| problem.lack(set);
    let best = found.sets().min_by(|a, b| lack(a).total_cmp(&lack(b)));
    let best = best.unwrap_or(nominal);
    let of_set = |set: &P::Set| {
        let own = problem.of_set(found, set);
        Statement {
            names: Some(set.names().to_vec()),
            features: head.features([&problem.density(set), &own, &[], &[]], &[]),
            claim: problem.claim(found, set),
        }
    };
    let other = |names, features| Statement {
        names,
        features,
        claim: Claim::of(vec![]),
    };
    let (of_none, of_unknown) = (problem.of_none(), problem.of_unknown(found, best));
    let none = head.features([&problem.density(nominal), &[], &of_none, &[]], &[]);
    let density = problem.density(best);
    let unknown = head.features([&density, &[], &[], &of_unknown], best.names());
    let others = [other(Some(vec![]), none), other(None, unknown)];
    found.sets().map(of_set).chain(others).collect()
}
