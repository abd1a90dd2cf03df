//! A diagnosis: sets of effects are fitted, the statements about the log get probabilities, the most probable is the verdict.

use crate::diagnosis::verdict::{Claim, Feature, Posterior, Statement, decide};
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
    let nominal = &found.nominal;
    let lack = |set: &P::Set| problem.lack(set);
    let best = found.sets().min_by(|a, b| lack(a).total_cmp(&lack(b)));
    let best = best.unwrap_or(nominal);
    let features = |set: &P::Set, own: Vec<Feature>, forms: &[&str]| {
        P::head().features(&[problem.density(set), own].concat(), forms)
    };
    let of_set = |set: &P::Set| Statement {
        names: Some(set.names().to_vec()),
        features: features(set, problem.of_set(found, set), &[]),
        claim: problem.claim(found, set),
    };
    let none = Statement {
        names: Some(vec![]),
        features: features(nominal, problem.of_none(), &[]),
        claim: Claim::of(vec![]),
    };
    let unknown = Statement {
        names: None,
        features: features(best, problem.of_unknown(found, best), best.names()),
        claim: Claim::default(),
    };
    found.sets().map(of_set).chain([none, unknown]).collect()
}
