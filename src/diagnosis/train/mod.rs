//! Training of the probabilities of a diagnosis ([`crate::diagnosis::posterior`]).
//!
//! Units run the catalogue's laws, each multiplied by a random function of the pistons and the time, with small effects of every kind
//! beside them, or a random law that the catalogue lacks. The exam ([`crate::diagnosis::exam`]) asks about the built-in plant, which has
//! laws of its own. Random rigs ([`rig`]) train the probabilities of other rigs.

pub mod case;
pub mod deform;
pub mod fit;
pub mod rig;
pub mod signals;
pub mod unit;

use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;

/// Share of the laws outside a catalogue that act beside an effect of it.
const BESIDE: f64 = 0.4;

/// What a training log is to have: effects of a catalogue, and `None` for a law that it lacks. The contents are about as frequent as in an
/// exam.
fn contents<T>(mut catalogue: Vec<T>, rng: &mut StdRng) -> Vec<Option<T>> {
    catalogue.shuffle(rng);
    let (known, foreign) = match rng.random_range(0..32) {
        0..13 => (1, false),
        13..20 => (2, false),
        20 => (3, false),
        21..27 => (0, false),
        _ => (usize::from(rng.random_bool(BESIDE)), true),
    };
    catalogue
        .into_iter()
        .take(known)
        .map(Some)
        .chain(foreign.then_some(None))
        .collect()
}
