//! Errors of a plant's configuration.

use std::ops::RangeInclusive;
use thiserror::Error;

/// Why a plant cannot be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlantError {
    /// A parameter is outside the range that the physics supports.
    #[error("plant.{name} = {value} is outside {low} to {high}; {mend}")]
    Range {
        /// Path of the parameter below `[plant]`.
        name: String,
        /// The value given.
        value: f64,
        /// Smallest value accepted.
        low: f64,
        /// Largest value accepted.
        high: f64,
        /// Advice on a plausible value.
        mend: &'static str,
    },
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
pub(crate) fn range(name: &str, value: f64, allowed: &RangeInclusive<f64>, mend: &'static str) -> Result<(), PlantError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    Err(PlantError::Range { name: name.to_owned(), value, low: *allowed.start(), high: *allowed.end(), mend })
}
