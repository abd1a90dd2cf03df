//! A diagnosis: sets of effects are fitted, the statements about the log get probabilities, the most probable is the verdict.

use crate::diagnosis::verdict::{Claim, Feature, Posterior, Statement, decide};
use crate::diagnosis::{Candidates, Documented, Judged, Problem, Scored};

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
pub fn diagnose<P: Documented>(problem: &P) -> Diagnosed<P::Document, P::Set> {
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

/// Fits and scores sets of effects: every single effect, the pairs that may explain more, and triples where a pair leaves something.
/// [`decide()`] checks whether a set needs all its members.
pub fn search<P: Problem>(problem: &P) -> Candidates<P::Set> {
    let [singles, pairs] = problem.singles_and_pairs();
    let mut found = Candidates {
        nominal: problem.nominal().clone(),
        singles,
        larger: vec![],
    };
    found.add(pairs);
    if let Some(triples) = found.larger.first().map(|pair| problem.triples(pair)) {
        let parts = problem.parts(&found, &triples);
        found.add(triples.into_iter().chain(parts));
    }
    found
}

/// All statements about a log, with the features that their probabilities are made from: each set, the nominal model, `unknown`. The score of
/// a set rises with the predictive density of the left-out blocks and falls with its freedom.
pub fn statements<P: Problem>(problem: &P, found: &Candidates<P::Set>) -> Vec<Statement> {
    let nominal = &found.nominal;
    let lack = |set: &P::Set| problem.lack(set);
    let best = found.sets().min_by(|a, b| lack(a).total_cmp(&lack(b)));
    let best = best.unwrap_or(nominal);
    let features = |set: &P::Set, own: Vec<Feature>, forms: &[&str]| {
        let own = problem.density(set).into_iter().chain(own);
        let own = own.map(|(name, value)| (name.to_owned(), value));
        let forms = forms.iter().map(|name| (format!("form_{name}"), 1.0));
        own.chain(forms).collect()
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
        features: features(best, problem.of_unknown(found, best), &P::forms(best)),
        claim: Claim::default(),
    };
    found.sets().map(of_set).chain([none, unknown]).collect()
}
