//! Shares of the gap by effect and by stage.
//!
//! A single effect is credited with what it closes on held-out blocks. Each of several effects is credited with the mean of
//! what it closes when added first and when added last (of two effects that is Shapley's value, 1953), because effects together do not
//! close the sum of what each closes alone. What the verdict leaves is attributed to the stages in proportion to the probabilities of
//! their effects.

use crate::diagnosis::tip::fit::Candidate;
use crate::diagnosis::{Candidates, Scored};
use crate::model::effects::{Effect, Stage};
use serde::Serialize;

/// A stage and its share of the gap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageShare {
    /// Stage name.
    pub name: &'static str,
    /// Share, 0..=1; all shares add up to 1.
    pub share: f64,
}

/// Part of the gap (deg²) that each effect of the set closes.
pub fn credits(
    found: &Candidates<Candidate>,
    chosen: &Candidate,
    gap: f64,
) -> Vec<(&'static str, f64)> {
    let (nominal, all) = (found.nominal.energy(), chosen.energy());
    let energy = |c: Option<&Candidate>| c.map_or(nominal, Candidate::energy);
    let share = |name: &&'static str| {
        let first = nominal - energy(found.single(name));
        let last = energy(found.without(chosen, name)) - all;
        (*name, (0.5 * (first + last) / gap).clamp(0.0, 1.0))
    };
    chosen.names.iter().map(share).collect()
}

/// Shares of the seven stages, the largest first.
pub fn stages(
    catalogue: &[Box<dyn Effect>],
    credits: &[(&'static str, f64)],
    probabilities: &[(&'static str, f64)],
) -> Vec<StageShare> {
    let of = |list: &[(&'static str, f64)], stage: Stage| -> f64 {
        let here = |name: &str| {
            catalogue
                .iter()
                .any(|e| e.name() == name && e.stage() == stage)
        };
        let own = list.iter().filter(|(name, _)| here(name));
        own.map(|(_, share)| share).sum()
    };
    let [credited, probable] =
        [credits, probabilities].map(|list| list.iter().map(|c| c.1).sum::<f64>().max(1e-9));
    let known = credited.min(1.0);
    let share = |&s: &Stage| {
        let [closed, left] = [of(credits, s) * known, of(probabilities, s) * (1.0 - known)];
        let (name, share) = (s.name(), closed / credited + left / probable);
        StageShare { name, share }
    };
    let mut out: Vec<StageShare> = Stage::ALL.iter().map(share).collect();
    let total: f64 = out.iter().map(|s| s.share).sum::<f64>().max(1e-12);
    out.iter_mut().for_each(|s| s.share /= total);
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::catalogue;

    #[test]
    fn the_seven_shares_add_up_to_one() {
        let shares = stages(
            &catalogue(),
            &[("leak", 0.6), ("gravity", 0.3)],
            &[("leak", 0.9), ("torsion", 0.1)],
        );
        assert_eq!(shares.len(), 7);
        assert!((shares.iter().map(|s| s.share).sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!((shares[0].name, shares[1].name), ("transmission", "shape"));
        assert!(
            (shares[0].share - 0.69).abs() < 1e-9,
            "0.6 closed and nine tenths of the remainder"
        );
    }

    #[test]
    fn without_a_verdict_the_shares_follow_the_probabilities() {
        let shares = stages(&catalogue(), &[], &[("hard_iron", 0.3), ("leak", 0.1)]);
        assert_eq!(shares[0].name, "sensor");
        assert!((shares[0].share - 0.75).abs() < 1e-6);
    }
}
