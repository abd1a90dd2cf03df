//! Turns the posterior into a verdict: `none`, a minimal set of effects, or `unknown`.
//!
//! The verdict is the most probable of the three. An effect is reported only if it reduces the held-out RMSE of at least one quantity by
//! 0.3° (0.3 °/s for the gyroscope), the published bar ([`CLAIM_DEG`]); what is below the bar counts as `none`.

use crate::diagnosis::holdout::CLAIM_DEG;
use crate::diagnosis::posterior::Posterior;
use crate::diagnosis::search::{Candidate, Candidates};
use crate::named;
use serde::Serialize;

/// Ratio of the probabilities of two statements below which a log does not decide between them (Kass and Raftery, *JASA* 1995: a Bayes
/// factor up to 3 is worth no more than a bare mention).
const UNDECIDED: f64 = 3.0;

named! {
    /// Kind of a verdict.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum VerdictKind {
        /// The nominal model suffices.
        None = "none",
        /// The named effects explain the log.
        Effects = "effects",
        /// A structured remainder is left that no set explains.
        #[default]
        Unknown = "unknown",
    }
}

impl VerdictKind {
    /// The kind for a set that may be empty and a remainder that may be unexplained.
    pub fn new(empty: bool, unexplained: bool) -> Self {
        match (unexplained, empty) {
            (true, _) => Self::Unknown,
            (false, true) => Self::None,
            (false, false) => Self::Effects,
        }
    }
}

/// The verdict on a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Kind.
    pub kind: VerdictKind,
    /// The smallest set that explains the log, or the part of it that is explained.
    pub names: Vec<&'static str>,
    /// Probability that a cause outside the catalogue is present.
    pub doubt: f64,
    /// Groups of effects, one of them in the set, between which the log does not decide.
    pub equivalent: Vec<Vec<&'static str>>,
}

/// Decides, and returns the chosen candidate with the verdict.
pub fn decide<'a>(found: &'a Candidates, posterior: &Posterior<'a>) -> (Verdict, &'a Candidate) {
    let mut sets: Vec<(&Candidate, f64)> = Vec::new();
    for (c, p) in posterior.ranked.iter().filter_map(|(s, p)| s.map(|c| (claimable(found, c), p))) {
        match sets.iter_mut().find(|(known, _)| known.names == c.names) {
            Some((_, sum)) => *sum += p,
            None => sets.push((c, *p)),
        }
    }
    let doubt = posterior.unknown();
    let none = sets.iter().filter(|(c, _)| c.names.is_empty()).map(|s| s.1).sum::<f64>();
    let effects = 1.0 - doubt - none;
    let best = sets.iter().filter(|(c, _)| !c.names.is_empty()).max_by(|a, b| a.1.total_cmp(&b.1));
    // of an unknown cause, a part may be explained
    let chosen = best.filter(|_| effects > none).map_or(&found.nominal, |best| best.0);
    let kind = VerdictKind::new(chosen.names.is_empty(), doubt > effects.max(none));
    let equivalent = if kind == VerdictKind::Effects { groups(posterior, chosen) } else { vec![] };
    (Verdict { kind, names: chosen.names.clone(), doubt, equivalent }, chosen)
}

/// The part of a set that may be claimed: each of its effects reduces the error of a quantity enough.
fn claimable<'a>(found: &'a Candidates, c: &'a Candidate) -> &'a Candidate {
    let enough = |before: &Candidate| before.held_out.gain(&c.held_out) >= CLAIM_DEG;
    let alone = || c.names.iter().filter_map(|n| found.single(n)).min_by(|a, b| a.energy().total_cmp(&b.energy()));
    match c.names.as_slice() {
        [] => c,
        [_] if enough(&found.nominal) => c,
        [_] => &found.nominal,
        several if several.iter().filter_map(|n| found.single(n)).all(enough) => c,
        _ => alone().map_or(&found.nominal, |single| claimable(found, single)),
    }
}

/// For each effect of the chosen set, it and those that could stand in its place.
fn groups(posterior: &Posterior<'_>, chosen: &Candidate) -> Vec<Vec<&'static str>> {
    let p = |names: &[&str]| posterior.sum(|s| s.is_some_and(|c| c.names == names));
    let least = p(&chosen.names) / UNDECIDED;
    let of = |name: &&'static str| {
        let rest = |c: &Candidate| chosen.names.iter().filter(|n| *n != name).all(|n| c.names.contains(n));
        let others = posterior.ranked.iter().filter_map(|(s, p)| s.filter(|_| *p >= least));
        let others = others.filter(|c| c.names.len() == chosen.names.len() && !c.names.contains(name) && rest(c));
        let stand_in = others.flat_map(|c| c.names.iter().copied().filter(|n| !chosen.names.contains(n)));
        std::iter::once(*name).chain(stand_in).collect::<Vec<_>>()
    };
    chosen.names.iter().map(of).filter(|group| group.len() > 1).collect()
}
