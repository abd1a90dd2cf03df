//! A rig as a problem: its sets, and the features of the statements about it.

use crate::diagnosis::rig::{
    DRIVEN, Document, RESONANT, RigProblem, STILL, Set, Signals, closed_ci95, poor, variance,
};
use crate::diagnosis::verdict::{Claim, Feature, Head};
use crate::diagnosis::{Candidates, Judged, Problem, Scored};
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.1;
/// Least ratio of a remainder to what it is compared with that counts.
const LEAST: f64 = 0.01;

/// Density that tells an effect from noise, and one that tells an effect from its form.
const SLIGHT: [f64; 2] = [0.03, 0.3];
/// Logarithm of the part of the gap that a right effect of another form may leave.
const FORM: f64 = -1.2;

/// The features but for those of the operators.
const FEATURES: [&str; 17] = [
    // of every statement, what it gains over the nominal model (for `unknown`, the best set): the density of the long and of the short blocks
    "density_long",
    "density_short",
    // the mean of both up to each of `SLIGHT`
    "slight",
    "clear",
    // of a set, the number of effects beyond the first
    "further_effects",
    // eighths of the number of columns
    "columns",
    // the two of `Candidates::claims`
    "claim",
    "second_claim",
    // of `none`, one, and the logarithm of what is left above the noise over the noise, the same where it is negative, and over the output
    "none",
    "none_noise",
    "none_below_noise",
    "none_output",
    // of `unknown`, one, and the logarithm of what the best set leaves above the noise over the noise, the same where it is negative, over
    // the gap, and the same above `FORM`
    "unknown",
    "unknown_noise",
    "unknown_below_noise",
    "unknown_left",
    "unknown_much_left",
];

/// The weights that diagnoses use.
static HEAD: LazyLock<Head> = LazyLock::new(|| {
    let operators = DRIVEN.iter().chain(&STILL).chain(&RESONANT);
    let mut effects: Vec<&'static str> = operators.map(|o| o.name).collect();
    effects.sort_unstable();
    effects.dedup();
    Head::built_in(include_str!("posterior.toml"), &FEATURES, &effects)
});

/// Half the logarithm of a ratio of squares.
fn ratio(of: f64, to: f64) -> f64 {
    (of / to.max(f64::MIN_POSITIVE)).max(LEAST * LEAST).ln() / 2.0
}

impl RigProblem<'_> {
    /// What a set gains over the nominal model: density of the long and of the short blocks.
    fn gained(&self, set: &Set) -> [f64; 2] {
        let (reference, own) = (self.nominal.scores.density(), set.scores.density());
        [0, 1].map(|k| reference[k] - own[k])
    }

    /// Mean square that a set leaves above the noise.
    fn above(&self, set: &Set) -> f64 {
        (set.energy() - self.noise * self.noise).max(0.0)
    }

    /// Variance of the outputs, each within its log.
    pub(super) fn variance(&self) -> f64 {
        let of = |log: &Signals| variance(&log.output) * log.output.len() as f64;
        self.logs.iter().map(of).sum::<f64>() / self.task.y.len() as f64
    }

    /// The logarithm of what a set leaves above the noise over the noise.
    fn noisy(&self, set: &Set) -> f64 {
        ratio(self.above(set), self.noise * self.noise)
    }
}

impl Problem for RigProblem<'_> {
    type Document = Document;

    fn head() -> &'static Head {
        &HEAD
    }
    fn lack(&self, set: &Set) -> f64 {
        2.0 * PER_EFFECT * set.names.len() as f64 - self.gained(set).iter().sum::<f64>()
    }
    fn density(&self, set: &Set) -> Vec<Feature> {
        let [long, short] = self.gained(set);
        let [slight, clear] = SLIGHT.map(|most| ((long + short) / 2.0 / most).min(1.0));
        vec![
            ("density_long", long),
            ("density_short", short),
            ("slight", slight),
            ("clear", clear),
        ]
    }
    fn of_set(&self, found: &Candidates<Set>, set: &Set) -> Vec<Feature> {
        let columns: usize = set.members.iter().map(|m| m.columns.len()).sum();
        let [claim, second_claim] = found.claims(set);
        vec![
            ("further_effects", set.names.len() as f64 - 1.0),
            ("columns", columns as f64 / 8.0),
            ("claim", claim),
            ("second_claim", second_claim),
        ]
    }
    fn of_none(&self) -> Vec<Feature> {
        let noise = self.noisy(&self.nominal);
        let output = ratio(self.above(&self.nominal), self.variance());
        vec![
            ("none", 1.0),
            ("none_noise", noise),
            ("none_below_noise", noise.min(0.0)),
            ("none_output", output),
        ]
    }
    fn of_unknown(&self, _: &Candidates<Set>, best: &Set) -> Vec<Feature> {
        let noise = self.noisy(best);
        let left = ratio(self.above(best), self.above(&self.nominal));
        vec![
            ("unknown", 1.0),
            ("unknown_noise", noise),
            ("unknown_below_noise", noise.min(0.0)),
            ("unknown_left", left),
            ("unknown_much_left", (left - FORM).max(0.0)),
        ]
    }
    /// The effects that surely close enough of the gap. What the set leaves of the gap beyond noise is unknown in proportion.
    fn claim(&self, found: &Candidates<Set>, set: &Set) -> Claim {
        if poor(self.logs) {
            return Claim::default();
        }
        let floor = self.nominal.energy() - self.gap;
        let sure = |c: &Set, part: &Set| closed_ci95(&part.scores, &c.scores, floor, self.seed)[0];
        let kept = found.claimable(set, &|c, part| c.gain(part) >= 1.0 && sure(c, part) > 0.0);
        let above = (kept.energy() - floor).max(0.0);
        let structured = above / kept.energy().max(f64::MIN_POSITIVE);
        Claim {
            names: (!kept.names.is_empty()).then(|| kept.names.clone()),
            unexplained: (above / self.gap * structured).min(1.0),
        }
    }

    fn stand_ins(&self, found: &Candidates<Set>, names: &[&'static str]) -> Vec<&'static str> {
        let least = found.set(names).unwrap_or(&found.nominal).energy();
        let better = found.singles.iter().filter(|s| s.energy() < least);
        better.map(|s| s.names[0]).collect()
    }
    fn document(&self, judged: &Judged<Self>) -> Document {
        self.written(judged)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        assert!(HEAD.weights[1] > 0.0 && (0.5..1.0).contains(&HEAD.conformal));
    }
}
