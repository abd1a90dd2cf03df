//! Features of the statements about a tip.
//!
//! The score of a set rises with the predictive density of the left-out blocks and falls with its freedom. The density of a block and
//! sensor is that of residuals whose variance is unknown ([`crate::diagnosis::tip::fit::holdout::density`]).

use crate::diagnosis::candidates::{Candidates, Scored};
use crate::diagnosis::tip::fit::candidate::Candidate;
use crate::diagnosis::tip::fit::holdout::HeldOut;
use crate::diagnosis::tip::observed::Observed;
use crate::diagnosis::tip::observed::dependence::dependences;
use crate::diagnosis::tip::observed::quantity::Quantity;
use crate::diagnosis::verdict::posterior::{Claim, Head, Layout, Statement};
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
const NAMES: [&str; 13] = [
    "density",
    "density_gyro",
    "further_effects",
    "information",
    "claim",
    "second_claim",
    "unusual",
    "none_worst",
    "unknown_worst",
    "unknown_best",
    "unknown_nominal",
    "unknown_share",
    "unknown_single",
];

/// All features.
static LAYOUT: LazyLock<Layout> = LazyLock::new(|| Layout {
    common: &NAMES,
    effects: catalogue().iter().map(|e| e.name()).collect(),
});

/// The weights that diagnoses use.
pub static HEAD: LazyLock<Head> =
    LazyLock::new(|| Head::built_in(include_str!("posterior.toml"), &LAYOUT));

/// All statements about a log: each set, the nominal model, `unknown`.
pub fn statements(log: &Observed, found: &Candidates<Candidate>) -> Vec<Statement> {
    let nominal = &found.nominal;
    let [long, short] = [0, 1].map(|k| move |c: &Candidate| log.mean(&c.held_out.density[k]));
    let merit = |c: &&Candidate| long(c) + short(c) + 2.0 * PER_EFFECT * c.names.len() as f64;
    let best = found
        .sets()
        .min_by(|a, b| merit(a).total_cmp(&merit(b)))
        .unwrap_or(nominal);
    let density = |c: &Candidate| {
        [
            -short(c),
            if log.has[Quantity::Gyro] {
                -c.held_out.density[1][Quantity::Gyro]
            } else {
                0.0
            },
        ]
    };
    let of_set = |c: &Candidate| {
        let information = (c.fitted.information - nominal.fitted.information) / 10.0;
        let [claim, second_claim] = found.claims(c);
        let own = [
            c.names.len() as f64 - 1.0,
            information,
            claim,
            second_claim,
            c.unusual,
        ];
        Statement {
            names: Some(c.names.clone()),
            features: features(density(c), own, 0.0, [0.0; 5], &[]),
            // what is below the bar counts as `none`
            claim: Claim::of(found.claimable(c, &enough).names.clone()),
        }
    };
    let none = features(
        density(nominal),
        [0.0; 5],
        worst_deg(log, &nominal.held_out).ln(),
        [0.0; 5],
        &[],
    );
    let share = dependences(log, &best.held_out.residual)
        .iter()
        .map(|d| d.share)
        .fold(0.0, f64::max);
    let single = short(best)
        - found
            .singles
            .iter()
            .map(short)
            .fold(f64::INFINITY, f64::min)
            .min(short(nominal));
    let own = [
        worst_deg(log, &best.held_out).ln(),
        long(best),
        short(nominal),
        share,
        single,
    ];
    let unknown = features(density(best), [0.0; 5], 0.0, own, &best.names);
    let others = [
        Statement {
            names: Some(vec![]),
            features: none,
            claim: Claim::of(vec![]),
        },
        Statement {
            names: None,
            features: unknown,
            claim: Claim::of(vec![]),
        },
    ];
    found.sets().map(of_set).chain(others).collect()
}

/// Whether a set explains enough beyond a part of it.
fn enough(c: &Candidate, part: &Candidate) -> bool {
    c.gain(part) >= SHOWN
}

/// Features of a statement: the densities, those of a set, of `none`, and of `unknown` with the effects of the best set.
fn features(
    density: [f64; 2],
    set: [f64; 5],
    none: f64,
    unknown: [f64; 5],
    best: &[&str],
) -> Vec<f64> {
    LAYOUT.features(
        density.into_iter().chain(set).chain([none]).chain(unknown),
        best,
    )
}

/// Largest RMS of a sensor above the noise, degrees or °/s.
fn worst_deg(log: &Observed, h: &HeldOut) -> f64 {
    let above = |q| {
        (h.rmse_deg[q].powi(2) - 3.0 * log.noise_deg[q].powi(2))
            .max(0.0)
            .sqrt()
    };
    log.quantities().map(above).fold(0.05, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        let head = &*HEAD;
        assert!(
            head.weights[0] > 0.0 && (0.5..1.0).contains(&head.conformal),
            "{head:?}"
        );
    }
}
