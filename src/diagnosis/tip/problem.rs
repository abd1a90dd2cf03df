//! A tip as a problem: its sets, and the features of the statements about it.
//!
//! The density of a block and sensor is that of residuals whose variance is unknown ([`crate::diagnosis::tip::fit::holdout::density`]).

use crate::diagnosis::tip::fit::Candidate;
use crate::diagnosis::tip::observed::{Quantity, dependences};
use crate::diagnosis::tip::{Diagnosis, TipProblem, alike};
use crate::diagnosis::verdict::{Claim, Head};
use crate::diagnosis::{Candidates, Judged, Problem, Scored};
use crate::model::effects::catalogue;
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.15;

/// Part of the least claimed error, which an effect brings to a recalibrated model, that the effect must explain beyond the others of its
/// set. The labels of the training logs hold that error itself, so the weights know it; a law of another form explains a part of it, and the
/// other effects, fitted again without it, take over another part.
const SHOWN: f64 = 2.0 / 3.0;

/// The features but for those of the effects. For every statement, the density of the left-out short blocks: the mean over the sensors,
/// and that of the gyroscope (for `unknown`, of the best set). For a set: the number of effects beyond the first; what the log tells about
/// its parameters ([`crate::diagnosis::tip::fit::Fitted::information`]); the logarithm of the largest gain of a sensor over the least that is
/// claimed, where it is less; for several effects, the same of the least of what each adds to the others; and the part of the parameters
/// that no usual form of the cause has. For `none`, the logarithm of the largest RMS of a sensor above the noise, degrees. For `unknown`: the
/// same with the best set, the density of its long blocks, that of the short blocks with the nominal model, the largest part of what a
/// sensor leaves that some dependence predicts, and what the best set gains over the best single effect: several effects together imitate
/// many a law.
const NAMES: [&str; 4] = [
    "density density_gyro",
    "further_effects information claim second_claim unusual",
    "none_worst",
    "unknown_worst unknown_best unknown_nominal unknown_share unknown_single",
];

/// The weights that diagnoses use.
static HEAD: LazyLock<Head> = LazyLock::new(|| {
    let effects = catalogue().iter().map(|e| e.name()).collect();
    Head::built_in(include_str!("posterior.toml"), NAMES, effects)
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
    fn density(&self, set: &Candidate) -> Vec<f64> {
        let gyro = match self.log.has[Quantity::Gyro] {
            true => -set.held_out.density[1][Quantity::Gyro],
            false => 0.0,
        };
        vec![-self.short(set), gyro]
    }
    fn of_set(&self, found: &Candidates<Candidate>, set: &Candidate) -> Vec<f64> {
        let further = set.names.len() as f64 - 1.0;
        let information = (set.information - self.nominal.information) / 10.0;
        let [claim, second] = found.claims(set);
        vec![further, information, claim, second, set.unusual]
    }
    fn of_none(&self) -> Vec<f64> {
        vec![self.worst(&self.nominal)]
    }
    fn of_unknown(&self, found: &Candidates<Candidate>, best: &Candidate) -> Vec<f64> {
        let nominal = self.short(&self.nominal);
        let depends = dependences(self.log, &best.held_out.residual);
        let share = depends.iter().map(|d| d.share).fold(0.0, f64::max);
        let singles = found.singles.iter().map(|s| self.short(s));
        let single = singles.fold(f64::INFINITY, f64::min);
        let long = self.log.mean(&best.held_out.density[0]);
        let beyond_single = self.short(best) - single.min(nominal);
        vec![self.worst(best), long, nominal, share, beyond_single]
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
