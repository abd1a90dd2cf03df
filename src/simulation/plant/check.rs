//! What a plant refuses, said so that the file can be mended.

use std::ops::RangeInclusive;
use thiserror::Error;

/// Why a plant cannot be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlantError {
    /// A parameter is not a number the physics can run with.
    #[error("plant.{name} = {value} is outside {low} to {high}; {mend}")]
    Range {
        /// Path of the parameter below `[plant]`.
        name: String,
        /// What was given.
        value: f64,
        /// Smallest accepted.
        low: f64,
        /// Largest accepted.
        high: f64,
        /// What to do about it.
        mend: &'static str,
    },
    /// An effect that the plant cannot make.
    #[error("no effect is called `{name}`; the plant makes {known}")]
    UnknownEffect {
        /// What was asked for.
        name: String,
        /// All that there is.
        known: String,
    },
}

/// `value` lies within `allowed` (a NaN never does).
pub(crate) fn range(name: &str, value: f64, allowed: RangeInclusive<f64>, mend: &'static str) -> Result<(), PlantError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    Err(PlantError::Range { name: name.to_owned(), value, low: *allowed.start(), high: *allowed.end(), mend })
}

/// Every one of `values` lies within `allowed`; the message counts from 1, as channels do.
pub(crate) fn ranges(name: &str, values: &[f64], allowed: RangeInclusive<f64>, mend: &'static str) -> Result<(), PlantError> {
    values.iter().enumerate().try_for_each(|(i, &v)| range(&format!("{name}[{}]", i + 1), v, allowed.clone(), mend))
}

/// A channel as files count it, 1 to 3.
pub(crate) fn channel(name: &str, channel: usize) -> Result<(), PlantError> {
    range(name, channel as f64, 1.0..=3.0, "channels are counted from 1 to 3")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_the_thing_the_value_and_the_range() {
        let why = ranges("line.k_epsilon", &[2.0, -1.0], 0.0..=10.0, "identify it again").unwrap_err();
        assert_eq!(why.to_string(), "plant.line.k_epsilon[2] = -1 is outside 0 to 10; identify it again");
        assert!(range("x", f64::NAN, 0.0..=1.0, "").is_err());
        assert!(channel("effects.leak.channel", 0).is_err() && channel("c", 3).is_ok());
    }
}
