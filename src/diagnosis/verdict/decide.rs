//! Turns the posterior of what may be claimed into a verdict: `none`, a set of effects, or `unknown`.
//!
//! The verdict is the most probable statement. Effects that a log cannot tell apart at all share their probability and count as one.

use crate::diagnosis::verdict::{Posterior, Said, exchanged};
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
    /// The kind of the statement that these effects explain a log, or of `unknown`.
    pub fn of(names: Option<&[&str]>) -> Self {
        match names {
            None => Self::Unknown,
            Some([]) => Self::None,
            Some(_) => Self::Effects,
        }
    }
}

/// A statement about a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StatementEntry {
    /// Kind.
    pub kind: VerdictKind,
    /// Names of the effects that explain the log.
    pub names: Vec<&'static str>,
    /// Its probability.
    pub probability: f64,
}

impl StatementEntry {
    fn new((names, probability): &Said) -> Self {
        Self {
            kind: VerdictKind::of(names.as_deref()),
            names: names.clone().unwrap_or_default(),
            probability: *probability,
        }
    }
}

/// The verdict on a log.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Verdict {
    /// Kind.
    pub kind: VerdictKind,
    /// The smallest set that explains the log, or the part of it that is explained.
    pub names: Vec<&'static str>,
    /// Probability of the statement, with that of the sets that have another effect of a group in place of its own.
    pub probability: f64,
    /// Groups of effects, one of them in the set, between which the log does not decide.
    pub equivalent: Vec<Vec<&'static str>>,
    /// Statements of which one is true in 95 % of all logs, the most probable first.
    pub conformal: Vec<StatementEntry>,
    /// Probability that a cause outside the catalogue is present.
    #[serde(skip)]
    pub doubt: f64,
}

impl Verdict {
    /// Whether the set or a group has an effect.
    pub fn speaks_of(&self, name: &str) -> bool {
        let groups = self.equivalent.iter().chain([&self.names]);
        groups.flatten().any(|n| *n == name)
    }
}

/// Decides. The log cannot tell the effects of the pairs `alike` apart; `better` are the single effects that leave less than a set does.
pub fn decide(
    posterior: &Posterior,
    alike: &[[&'static str; 2]],
    better: impl Fn(&[&'static str]) -> Vec<&'static str>,
) -> Verdict {
    let doubt = posterior.unknown();
    let ranked = &posterior.ranked;
    let sets = || ranked.iter().filter_map(|(names, _)| names.as_deref());
    let pooled = |names: &[&'static str]| {
        let others = alike.iter().filter_map(|pair| exchanged(names, pair));
        posterior.set(names) + others.map(|o| posterior.set(&o)).sum::<f64>()
    };
    // of equal sets the first, which was fitted
    let most = |is_asked: fn(&&[&str]) -> bool| {
        let asked = sets().rev().filter(is_asked);
        let most = asked.max_by(|a, b| pooled(a).total_cmp(&pooled(b)));
        most.unwrap_or_default()
    };
    let best = most(|_| true);
    let explained = (doubt <= pooled(best)).then_some(best);
    let kind = VerdictKind::of(explained);
    let effects = 1.0 - doubt - posterior.set(&[]);
    let names = match kind {
        // of an unknown cause, a part may be explained
        VerdictKind::Unknown if effects > posterior.set(&[]) => most(|names| !names.is_empty()),
        VerdictKind::Unknown => &[],
        _ => best,
    };
    let equivalent = match kind {
        VerdictKind::Effects => groups(posterior, names, alike, &better(names)),
        _ => vec![],
    };
    let same = sets().filter(|set| stands_for(set, names, &equivalent));
    let probability = match kind {
        VerdictKind::None => posterior.set(&[]),
        VerdictKind::Unknown => doubt,
        VerdictKind::Effects => same.map(|set| posterior.set(set)).sum(),
    };
    let conformal = posterior.conformal().iter().map(StatementEntry::new);
    Verdict {
        kind,
        names: names.to_vec(),
        probability,
        equivalent,
        conformal: conformal.collect(),
        doubt,
    }
}

/// Whether a set has each of these effects, or one of its group.
fn stands_for(set: &[&str], names: &[&'static str], groups: &[Vec<&'static str>]) -> bool {
    let has = |name: &&'static str| {
        let group = groups.iter().find(|g| g[0] == *name);
        set.contains(name) || group.is_some_and(|g| g.iter().any(|n| set.contains(n)))
    };
    set.len() == names.len() && names.iter().all(has)
}

/// For each effect of the chosen set, it and those that could stand in its place.
fn groups(
    posterior: &Posterior,
    chosen: &[&'static str],
    alike: &[[&'static str; 2]],
    better: &[&'static str],
) -> Vec<Vec<&'static str>> {
    let least = posterior.set(chosen) / UNDECIDED;
    let of = |name: &&'static str| {
        let rest = |names: &[&str]| chosen.iter().all(|n| n == name || names.contains(n));
        let beside = |names: &&[&'static str]| {
            names.len() == chosen.len() && !names.contains(name) && rest(names)
        };
        let probable = posterior.ranked.iter().filter(|(_, p)| *p >= least);
        let others = probable.filter_map(|(s, _)| s.as_deref()).filter(beside);
        let stand_in = others.flatten().copied();
        let partners = alike.iter().filter_map(|pair| exchanged(&[*name], pair));
        // a single effect that leaves less than a whole set could stand for any of it
        let mut group = vec![*name];
        for other in stand_in
            .chain(partners.flatten())
            .chain(better.iter().copied())
        {
            if !group.contains(&other) && !chosen.contains(&other) {
                group.push(other);
            }
        }
        group
    };
    let groups = chosen.iter().map(of);
    groups.filter(|group| group.len() > 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::verdict::{Claim, Head, Statement};
    use proptest::prelude::*;

    const NAMES: [&str; 5] = ["leak", "creep", "play", "delay", "latency"];

    fn verdict(ranked: &[(Option<&[&'static str]>, f64)]) -> Verdict {
        let said = ranked.iter().map(|(s, p)| (s.map(<[_]>::to_vec), *p));
        decide(
            &Posterior::of(said, 0.95),
            &[["delay", "latency"]],
            |_| vec![],
        )
    }

    #[test]
    fn the_most_probable_statement_is_the_verdict() {
        let v = verdict(&[(Some(&[]), 0.5), (None, 0.3), (Some(&["leak"]), 0.2)]);
        assert_eq!((v.kind, v.names.len()), (VerdictKind::None, 0));
        let v = verdict(&[(None, 0.4), (Some(&["leak"]), 0.3), (Some(&["creep"]), 0.3)]);
        assert_eq!(
            (v.kind, v.names, v.equivalent.len()),
            (VerdictKind::Unknown, vec!["leak"], 0),
            "a part is explained"
        );
    }

    #[test]
    fn what_could_stand_in_the_place_of_an_effect_is_in_its_group() {
        let v = verdict(&[
            (Some(&["leak", "creep"]), 0.4),
            (Some(&["play", "creep"]), 0.3),
            (Some(&["leak", "lag"]), 0.1),
            (None, 0.2),
        ]);
        assert_eq!(v.equivalent, [vec!["leak", "play"]]);
    }

    #[test]
    fn effects_that_a_log_cannot_tell_apart_count_as_one() {
        let p = Posterior::of([(Some(vec!["delay"]), 0.6), (None, 0.4)], 0.95)
            .shared(&[["delay", "latency"]]);
        let v = decide(&p, &[["delay", "latency"]], |_| vec![]);
        assert_eq!((v.kind, v.names), (VerdictKind::Effects, vec!["delay"]));
        assert_eq!(v.equivalent, [vec!["delay", "latency"]]);
        assert!((p.effect("latency") - 0.3).abs() < 1e-12);
    }

    proptest! {
        /// Whatever may be claimed of the sets, the verdict is the most probable statement, in its own 95 % set, and the
        /// probabilities add up to 1.
        #[test]
        fn the_verdict_is_its_posterior(
            said in proptest::collection::vec((0u8..33, 0.0..1.0f64, 0u8..32, 0.0..1.0f64), 1..12),
        ) {
            let names = |bits: u8| -> Vec<&'static str> {
                NAMES.iter().enumerate().filter(|(k, _)| bits >> k & 1 == 1).map(|(_, n)| *n).collect()
            };
            let statement = |s: &(u8, f64, u8, f64)| Statement {
                names: (s.0 < 32).then(|| names(s.0)),
                features: vec![("p".to_owned(), s.1.max(1e-9).ln())],
                claim: Claim { names: (s.2 != 31).then(|| names(s.2 & s.0)), unexplained: s.3 },
            };
            let alike = [["delay", "latency"]];
            let head = Head { weight: [("p".to_owned(), 1.0)].into(), conformal: 0.95 };
            let p = Posterior::new(&head, said.iter().map(statement).collect()).shared(&alike);
            prop_assert!((p.ranked.iter().map(|s| s.1).sum::<f64>() - 1.0).abs() < 1e-9);
            let v = decide(&p, &alike, |_| vec![]);
            let pooled = |names: &Option<Vec<&'static str>>| match names {
                None => p.unknown(),
                Some(names) => p.set(names)
                    + exchanged(names, &alike[0]).map_or(0.0, |o| p.set(&o)),
            };
            let own = match v.kind {
                VerdictKind::Unknown => None,
                _ => Some(v.names.clone()),
            };
            let most = p.ranked.iter().map(|(s, _)| pooled(s)).fold(0.0, f64::max);
            prop_assert!(pooled(&own) >= most - 1e-12, "{v:?} {p:?}");
            prop_assert!(p.conformal().iter().any(|(s, _)| pooled(s) >= most - 1e-12));
        }
    }
}
