//! A tip as a problem: its sets, and the features of the statements about it.
//!
//! The density of a block and sensor is that of residuals whose variance is unknown ([`crate::diagnosis::tip::fit::holdout::density`]).

use crate::diagnosis::tip::fit::Candidate;
use crate::diagnosis::tip::observed::{Quantity, dependences};
use crate::diagnosis::tip::{Diagnosis, TipProblem, alike};
use crate::diagnosis::verdict::{Claim, Feature, Head};
use crate::diagnosis::{Candidates, Judged, Problem, Scored};
use crate::model::effects::catalogue;
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.15;

/// Part of the least claimed error, which an effect brings to a recalibrated model, that the effect must explain beyond the others of its
/// set. The labels of the training logs hold that error itself, so the weights know it; a law of another form explains a part of it, and the
/// other effects, fitted again without it, take over another part.
const SHOWN: f64 = 2.0 / 3.0;

/// The features but for those of the effects.
const FEATURES: [&str; 13] = [
    // of every statement, the density of the left-out short blocks (for `unknown`, of the best set): mean over the sensors, and gyroscope
    "density",
    "density_gyro",
    // of a set, the number of effects beyond the first
    "further_effects",
    // what the log tells about its parameters: `Candidate::information`
    "information",
    // logarithm of the largest gain of a sensor over the least that is claimed, where it is less
    "claim",
    // of several effects, the same of the least of what each adds to the others
    "second_claim",
    // part of the parameters that no usual form of the cause has
    "unusual",
    // of `none`, logarithm of the largest RMS of a sensor above the noise, degrees
    "none_worst",
    // of `unknown`, the same with the best set
    "unknown_worst",
    // density of the long blocks of the best set
    "unknown_best",
    // density of the short blocks with the nominal model
    "unknown_nominal",
    // largest part of what a sensor leaves that some dependence predicts
    "unknown_share",
    // what the best set gains over the best single effect: several effects together imitate many a law
    "unknown_single",
];

/// The weights that diagnoses use.
static HEAD: LazyLock<Head> = LazyLock::new(|| {
    let effects: Vec<&str> = catalogue().iter().map(|e| e.name()).collect();
    Head::built_in(include_str!("posterior.toml"), &FEATURES, &effects)
});

impl TipProblem<'_> {
    /// Mean density of the short blocks.
    fn short(&self, set: &Candidate) -> f64 {
        self.log.mean(&set.held_out.density[1])
    }

    /// Logarithm of the largest RMS of a sensor above the noise, degrees or °/s.
    fn worst(&self, set: &Candidate) -> f64 {
        let square = |q| set.held_out.rmse_deg[q].powi(2) - 3.0 * self.log.noise_deg[q].powi(2);
        let roots = self.log.quantities().map(|q| square(q).max(0.0).sqrt());
        roots.fold(0.05, f64::max).ln()
    }
}

impl Problem for TipProblem<'_> {
    type Document = Diagnosis;

    fn head() -> &'static Head {
        &HEAD
    }
    fn lack(&self, set: &Candidate) -> f64 {
        let long = self.log.mean(&set.held_out.density[0]);
        long + self.short(set) + 2.0 * PER_EFFECT * set.names.len() as f64
    }
    fn density(&self, set: &Candidate) -> Vec<Feature> {
        let gyro = if self.log.has[Quantity::Gyro] {
            -set.held_out.density[1][Quantity::Gyro]
        } else {
            0.0
        };
        vec![("density", -self.short(set)), ("density_gyro", gyro)]
    }
    fn of_set(&self, found: &Candidates<Candidate>, set: &Candidate) -> Vec<Feature> {
        let information = (set.information - self.nominal.information) / 10.0;
        let [claim, second_claim] = found.claims(set);
        vec![
            ("further_effects", set.names.len() as f64 - 1.0),
            ("information", information),
            ("claim", claim),
            ("second_claim", second_claim),
            ("unusual", set.unusual),
        ]
    }
    fn of_none(&self) -> Vec<Feature> {
        vec![("none_worst", self.worst(&self.nominal))]
    }
    fn of_unknown(&self, found: &Candidates<Candidate>, best: &Candidate) -> Vec<Feature> {
        let nominal = self.short(&self.nominal);
        let depends = dependences(self.log, &best.held_out.residual);
        let singles = found.singles.iter().map(|s| self.short(s));
        let single = singles.fold(f64::INFINITY, f64::min);
        vec![
            ("unknown_worst", self.worst(best)),
            ("unknown_best", self.log.mean(&best.held_out.density[0])),
            ("unknown_nominal", nominal),
            (
                "unknown_share",
                depends.iter().map(|d| d.share).fold(0.0, f64::max),
            ),
            ("unknown_single", self.short(best) - single.min(nominal)),
        ]
    }
    fn claim(&self, found: &Candidates<Candidate>, set: &Candidate) -> Claim {
        // what is below the bar counts as `none`
        let shown = found.claimable(set, &|set, part| set.gain(part) >= SHOWN);
        Claim::of(shown.names.clone())
    }

    fn alike(&self) -> Vec<[&'static str; 2]> {
        alike(self.log.has[Quantity::Reference])
    }
    fn document(&self, judged: &Judged<Self>) -> Diagnosis {
        self.written(judged)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        assert!(HEAD.weights[0] > 0.0 && (0.5..1.0).contains(&HEAD.conformal));
    }
}
