//! Features of the statements about a rig.

use crate::diagnosis::candidates::{Candidates, Scored};
use crate::diagnosis::rig::model::RESONANT;
use crate::diagnosis::rig::operators::{DRIVEN, STILL};
use crate::diagnosis::rig::search::Set;
use crate::diagnosis::verdict::posterior::{Claim, Head, Layout, Statement};
use std::sync::LazyLock;

/// Surcharge per effect when the best set is chosen, in the unit of a density.
const PER_EFFECT: f64 = 0.1;
/// Least ratio of a remainder to what it is compared with that counts.
const LEAST: f64 = 0.01;

/// Density that tells an effect from noise, and one that tells an effect from its form.
const SLIGHT: [f64; 2] = [0.03, 0.3];
/// Logarithm of the part of the gap that a right effect of another form may leave.
const FORM: f64 = -1.2;

/// The features but for those of the operators. For every statement, what it gains over the nominal model (for `unknown`, the best set):
/// the density of the long and of the short blocks, and the mean of both up to each of [`SLIGHT`]. For a set: the number of effects
/// beyond the first, the number of columns, and the two claims of [`Candidates::claims`]. For `none`: one, and the logarithms of what is left
/// above the noise over the noise, the same where it is negative, and over the output. For `unknown`: one, and the logarithms of what the best
/// set leaves above the noise over the noise, the same where it is negative, over the gap, and the same above [`FORM`].
const NAMES: [&str; 17] = [
    "density_long",
    "density_short",
    "slight",
    "clear",
    "further_effects",
    "columns",
    "claim",
    "second_claim",
    "none",
    "none_noise",
    "none_below_noise",
    "none_output",
    "unknown",
    "unknown_noise",
    "unknown_below_noise",
    "unknown_left",
    "unknown_much_left",
];

/// All features.
static LAYOUT: LazyLock<Layout> = LazyLock::new(|| {
    let mut effects: Vec<&'static str> = DRIVEN
        .iter()
        .chain(&STILL)
        .chain(&RESONANT)
        .map(|o| o.name)
        .collect();
    effects.sort_unstable();
    effects.dedup();
    Layout {
        common: &NAMES,
        effects,
    }
});

/// The weights that diagnoses use.
pub static HEAD: LazyLock<Head> =
    LazyLock::new(|| Head::built_in(include_str!("posterior.toml"), &LAYOUT));

/// All statements about a log whose noise has the variance `floor` and whose output has the variance `output`.
/// `may_claim` is what may be claimed of a set.
pub fn statements(
    found: &Candidates<Set>,
    floor: f64,
    output: f64,
    may_claim: impl Fn(&Set) -> Claim,
) -> Vec<Statement> {
    let nominal = &found.nominal;
    let reference = nominal.scores.density();
    let densities = |s: &Set| [0, 1].map(|k| reference[k] - s.scores.density()[k]);
    let merit =
        |s: &&Set| densities(s).iter().sum::<f64>() - 2.0 * PER_EFFECT * s.names.len() as f64;
    let best = found
        .sets()
        .max_by(|a, b| merit(a).total_cmp(&merit(b)))
        .unwrap_or(nominal);
    let density = |s: &Set| {
        let [long, short] = densities(s);
        let [slight, clear] = SLIGHT.map(|most| ((long + short) / 2.0 / most).min(1.0));
        [long, short, slight, clear]
    };
    let of_set = |s: &Set| {
        let columns: usize = s.members.iter().map(|m| m.columns.len()).sum();
        let [claim, second_claim] = found.claims(s);
        let own = [
            s.names.len() as f64 - 1.0,
            columns as f64 / 8.0,
            claim,
            second_claim,
        ];
        Statement {
            names: Some(s.names.clone()),
            features: features(density(s), own, [0.0; 4], [0.0; 5], &[]),
            claim: may_claim(s),
        }
    };
    let above = |s: &Set| (s.energy() - floor).max(0.0);
    let ratio = |of: f64, to: f64| (of / to.max(f64::MIN_POSITIVE)).max(LEAST * LEAST).ln() / 2.0;
    let noise = ratio(above(nominal), floor);
    let none = [1.0, noise, noise.min(0.0), ratio(above(nominal), output)];
    let [noise, left] = [
        ratio(above(best), floor),
        ratio(above(best), above(nominal)),
    ];
    let unknown = [1.0, noise, noise.min(0.0), left, (left - FORM).max(0.0)];
    let others = [
        Statement {
            names: Some(vec![]),
            features: features([0.0; 4], [0.0; 4], none, [0.0; 5], &[]),
            claim: Claim::of(vec![]),
        },
        Statement {
            names: None,
            features: features(density(best), [0.0; 4], [0.0; 4], unknown, &best.names),
            claim: Claim::of(vec![]),
        },
    ];
    found.sets().map(of_set).chain(others).collect()
}

/// Features of a statement: the densities, those of a set, of `none`, and of `unknown` with the operators of the best set.
fn features(
    density: [f64; 4],
    set: [f64; 4],
    none: [f64; 4],
    unknown: [f64; 5],
    best: &[&str],
) -> Vec<f64> {
    LAYOUT.features(
        density.into_iter().chain(set).chain(none).chain(unknown),
        best,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_in_the_program_can_be_read() {
        let head = &*HEAD;
        assert!(
            head.weights[1] > 0.0 && (0.5..1.0).contains(&head.conformal),
            "{head:?}"
        );
    }
}
