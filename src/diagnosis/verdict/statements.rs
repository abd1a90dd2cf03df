//! The statements about a log, with the features that their probabilities are made from.
//!
//! The score of a set rises with the predictive density of the left-out blocks and falls with its freedom.

use crate::diagnosis::verdict::{Claim, Statement};
use crate::diagnosis::{Candidates, Problem, Scored};

/// All statements about a log: each set, the nominal model, `unknown`.
pub fn statements<P: Problem>(problem: &P, found: &Candidates<P::Set>) -> Vec<Statement> {
    let (nominal, layout) = (&found.nominal, &P::head().layout);
    let lack = |set: &P::Set| problem.lack(set);
    let best = found
        .sets()
        .min_by(|a, b| lack(a).total_cmp(&lack(b)))
        .unwrap_or(nominal);
    let of_set = |set: &P::Set| {
        let own = problem.of_set(found, set);
        Statement {
            names: Some(set.names().to_vec()),
            features: layout.features([&problem.density(set), &own, &[], &[]], &[]),
            claim: problem.claim(found, set),
        }
    };
    let other = |names, features| Statement {
        names,
        features,
        claim: Claim::of(vec![]),
    };
    let none = layout.features(
        [&problem.density(nominal), &[], &problem.of_none(), &[]],
        &[],
    );
    let of_unknown = problem.of_unknown(found, best);
    let unknown = layout.features(
        [&problem.density(best), &[], &[], &of_unknown],
        best.names(),
    );
    let others = [other(Some(vec![]), none), other(None, unknown)];
    found.sets().map(of_set).chain(others).collect()
}
