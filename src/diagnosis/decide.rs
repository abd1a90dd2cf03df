//! Turns the posterior into a verdict: `none`, a minimal set of effects, or `unknown`.
//!
//! The verdict is the most probable of the three. An effect is reported only if it explains enough beyond the others of its set
//! ([`crate::diagnosis::candidates`]): of a tip 0.3° of the error of a sensor (0.3 °/s of the gyroscope), of another rig 8 % of the gap. What
//! is below the bar counts as `none`.

use crate::diagnosis::posterior::Posterior;
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

/// Decides; `claimable` is the part of a set that may be claimed.
pub fn decide(
    posterior: &Posterior,
    claimable: impl Fn(&[&'static str]) -> Vec<&'static str>,
) -> Verdict {
    let mut sets: Vec<(Vec<&'static str>, f64)> = Vec::new();
    for (names, p) in posterior
        .ranked
        .iter()
        .filter_map(|(s, p)| s.as_deref().map(|names| (claimable(names), p)))
    {
        match sets.iter_mut().find(|(known, _)| *known == names) {
            Some((_, sum)) => *sum += p,
            None => sets.push((names, *p)),
        }
    }
    let doubt = posterior.unknown();
    let none = sets
        .iter()
        .filter(|(names, _)| names.is_empty())
        .map(|s| s.1)
        .sum::<f64>();
    let effects = 1.0 - doubt - none;
    let best = sets
        .into_iter()
        .filter(|(names, _)| !names.is_empty())
        .max_by(|a, b| a.1.total_cmp(&b.1));
    // of an unknown cause, a part may be explained
    let names = best
        .filter(|_| effects > none)
        .map_or(vec![], |best| best.0);
    let kind = VerdictKind::new(names.is_empty(), doubt > effects.max(none));
    let equivalent = if kind == VerdictKind::Effects {
        groups(posterior, &names)
    } else {
        vec![]
    };
    Verdict {
        kind,
        names,
        doubt,
        equivalent,
    }
}

/// For each effect of the chosen set, it and those that could stand in its place.
fn groups(posterior: &Posterior, chosen: &[&'static str]) -> Vec<Vec<&'static str>> {
    let least = posterior.set(chosen) / UNDECIDED;
    let of = |name: &&'static str| {
        let rest = |names: &[&str]| {
            chosen
                .iter()
                .filter(|n| *n != name)
                .all(|n| names.contains(n))
        };
        let others = posterior
            .ranked
            .iter()
            .filter(|(_, p)| *p >= least)
            .filter_map(|(s, _)| s.as_deref());
        let others = others
            .filter(|names| names.len() == chosen.len() && !names.contains(name) && rest(names));
        let stand_in =
            others.flat_map(|names| names.iter().copied().filter(|n| !chosen.contains(n)));
        std::iter::once(*name).chain(stand_in).collect::<Vec<_>>()
    };
    chosen
        .iter()
        .map(of)
        .filter(|group| group.len() > 1)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(ranked: &[(Option<&[&'static str]>, f64)]) -> Verdict {
        let ranked = ranked
            .iter()
            .map(|(s, p)| (s.map(<[_]>::to_vec), *p))
            .collect();
        // "faint" is below the bar
        decide(
            &Posterior {
                ranked,
                conformal: 1,
            },
            |names| names.iter().copied().filter(|n| *n != "faint").collect(),
        )
    }

    #[test]
    fn the_most_probable_kind_is_the_verdict_and_what_is_below_the_bar_counts_as_none() {
        let v = verdict(&[(Some(&["faint"]), 0.5), (None, 0.3), (Some(&["leak"]), 0.2)]);
        assert_eq!((v.kind, v.names.len()), (VerdictKind::None, 0));
        let v = verdict(&[(None, 0.5), (Some(&["leak"]), 0.4), (Some(&[]), 0.1)]);
        assert_eq!(
            (v.kind, v.names, v.equivalent.len()),
            (VerdictKind::Unknown, vec!["leak"], 0),
            "a part is explained"
        );
        let v = verdict(&[
            (Some(&["leak", "faint"]), 0.4),
            (None, 0.35),
            (Some(&["leak"]), 0.25),
        ]);
        assert_eq!(
            (v.kind, v.names),
            (VerdictKind::Effects, vec!["leak"]),
            "both say the same of what may be claimed"
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
}
