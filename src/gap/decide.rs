//! From scores to a verdict: none, a smallest set of effects, or unknown.
//!
//! All bars are in held-out residuals. Real units are never perfect, so an effect must lower some
//! kind's RMSE by at least 0.3° (0.3 °/s for the gyroscope) to be claimed at all; a second effect must
//! besides take a good part of what the first one leaves, because a truth of another form always
//! leaves something that a wrong second effect can feed on. The fractions below are reasoned, not
//! fitted: what a law of another form is expected to leave of the gap it causes.

use crate::gap::observe::Observed;
use crate::gap::search::{Candidate, Found, HeldOut};

/// Least gain of any kind's RMSE that is claimed, degrees or °/s.
pub const CLAIM_DEG: f64 = 0.3;
/// A second effect must take at least this share of the energy the first leaves above the floor.
const SECOND_SHARE: f64 = 0.45;
/// … and each of a pair must be worth at least this share of the whole gap.
const MEMBER_SHARE: f64 = 0.06;
/// Energy left above the floor, as a share of the whole gap, beyond which something is unexplained.
const LEFT_SHARE: f64 = 0.30;
/// … and RMSE of some kind beyond which it matters, degrees.
const LEFT_DEG: f64 = 0.8;

/// The answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// `none`, `effects` or `unknown`.
    pub kind: &'static str,
    /// The smallest set that explains the log, or the part of it that is explained.
    pub names: Vec<&'static str>,
    /// Share of the gap that the set leaves.
    pub left: f64,
}

/// Energy of pure noise in the same units as [`HeldOut::energy`], deg².
#[must_use]
pub fn floor(log: &Observed) -> f64 {
    (0..4).filter(|&k| log.has[k]).map(|k| 3.0 * log.noise_deg[k].powi(2)).sum()
}

/// Largest gain of any kind's RMSE from one set of scores to another.
#[must_use]
pub fn gain(from: &HeldOut, to: &HeldOut) -> f64 {
    from.rmse_deg.iter().zip(&to.rmse_deg).map(|(a, b)| a - b).fold(f64::NEG_INFINITY, f64::max)
}

/// Best scored candidate of a list.
fn best(list: &[Candidate]) -> Option<(&Candidate, &HeldOut)> {
    list.iter().map(|c| (c, &c.held_out)).min_by(|a, b| a.1.energy().total_cmp(&b.1.energy()))
}

/// Decides.
#[must_use]
pub fn decide(log: &Observed, found: &Found) -> Verdict {
    let floor = floor(log);
    let nominal = &found.nominal.held_out;
    let gap = (nominal.energy() - floor).max(1e-9);
    let Some((single, single_score)) = best(&found.singles).filter(|(_, h)| gain(nominal, h) >= CLAIM_DEG) else {
        return unexplained(nominal, vec![], floor, gap);
    };
    let (mut names, mut score) = (single.names.clone(), single_score);
    if let Some((pair, pair_score)) = best(&found.pairs) {
        let left = (single_score.energy() - floor).max(1e-9);
        let takes = (single_score.energy() - pair_score.energy()) / left;
        let needed = pair.names.iter().all(|n| worth(found, pair_score, pair, n) >= MEMBER_SHARE * gap);
        if takes >= SECOND_SHARE && gain(single_score, pair_score) >= CLAIM_DEG && needed {
            (names, score) = (pair.names.clone(), pair_score);
        }
    }
    unexplained(score, names, floor, gap)
}

/// What a member of a pair is worth: the energy that comes back when it is taken out.
fn worth(found: &Found, pair: &HeldOut, of: &Candidate, name: &str) -> f64 {
    let other = of.names.iter().find(|n| **n != name);
    let alone = found.singles.iter().find(|s| Some(&s.names[0]) == other).map(|s| &s.held_out);
    alone.map_or(f64::INFINITY, |a| a.energy() - pair.energy())
}

/// Whether what a set leaves is worth a doubt.
fn unexplained(score: &HeldOut, names: Vec<&'static str>, floor: f64, gap: f64) -> Verdict {
    let left = ((score.energy() - floor) / gap).max(0.0);
    let large = score.rmse_deg.iter().any(|&e| e > LEFT_DEG);
    let kind = if large && left > LEFT_SHARE {
        "unknown"
    } else if names.is_empty() {
        "none"
    } else {
        "effects"
    };
    Verdict { kind, names, left }
}
