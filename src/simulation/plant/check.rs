//! Errors of a plant's configuration.

use crate::primitives::{Checker, Invalid};
use std::ops::RangeInclusive;
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

/// Refuses a value outside `allowed`; a NaN always is.
pub(crate) fn range(
    key: &str,
    value: f64,
    allowed: RangeInclusive<f64>,
    advice: &str,
) -> Result<(), PlantError> {
    let mut checker = Checker::default();
    checker.at(key).range(value, allowed, "").hint(advice);
    Ok(checker.done()?)
}
