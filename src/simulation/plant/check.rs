//! Errors of a plant's configuration.

use crate::primitives::{Checker, Invalid};
use nalgebra::Vector3;
use thiserror::Error;

/// Why a plant cannot be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlantError {
    /// A parameter is outside the range that the physics supports; its key counts from `[plant]`.
    #[error("plant.{} = {}; {}", .0.shown_key(), .0.problem, .0.hint)]
    Range(#[from] Invalid),
    /// An effect that the plant does not have.
    #[error("no effect is called `{name}`; the plant has {known}")]
    UnknownEffect {
        /// The name given.
        name: String,
        /// All names that exist.
        known: String,
    },
}

/// Refuses a direction without a length.
pub(crate) fn directed(key: &str, direction: [f64; 3]) -> Result<(), PlantError> {
    let mut checker = Checker::default();
    let length = Vector3::from(direction).norm();
    let checked = checker.at(key).range(length, 1e-3..=1e4, "");
    checked.hint("a direction has a length");
    Ok(checker.done()?)
}
