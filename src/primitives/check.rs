//! Collects the first value of a file that is refused, with its key.

use std::fmt::Write;
use std::ops::RangeInclusive;

/// A value that is not accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {problem}; {hint}", shown(.key))]
pub struct Invalid {
    /// Dotted key; an index from 0 for arrays: `transmission.k_epsilon.1`.
    pub key: String,
    /// What was found and what is accepted.
    pub problem: String,
    /// How to correct it.
    pub hint: String,
}

impl Invalid {
    /// The key as it is shown to people, who count from one: `transmission.k_epsilon[2]`.
    pub fn shown_key(&self) -> String {
        shown(&self.key)
    }
}

/// A dotted key with its indices counted from one and in brackets.
pub fn shown(key: &str) -> String {
    key.split('.').fold(String::new(), |mut out, part| {
        let dot = if out.is_empty() { "" } else { "." };
        // writing to a string cannot fail
        let _ = match part.parse::<usize>() {
            Ok(index) => write!(out, "[{}]", index + 1),
            Err(_) => write!(out, "{dot}{part}"),
        };
        out
    })
}

/// Keeps the first problem.
#[derive(Debug, Default)]
pub struct Checker {
    first: Option<Invalid>,
}

impl Checker {
    /// A number must lie in a range; NaN never does.
    pub fn range(&mut self, key: &str, value: f64, allowed: RangeInclusive<f64>, unit: &str, hint: &str) {
        if !allowed.contains(&value) {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            self.refuse(key, format!("{value}{unit} is outside {} to {}{unit}", allowed.start(), allowed.end()), hint);
        }
    }

    /// Each number of an array must lie in a range.
    pub fn ranges(&mut self, key: &str, values: &[f64], allowed: RangeInclusive<f64>, unit: &str, hint: &str) {
        for (i, &v) in values.iter().enumerate() {
            self.range(&format!("{key}.{i}"), v, allowed.clone(), unit, hint);
        }
    }

    /// A relation between values must hold.
    pub fn holds(&mut self, key: &str, good: bool, problem: &str, hint: &str) {
        if !good {
            self.refuse(key, problem.to_owned(), hint);
        }
    }

    /// Refuses a value.
    pub fn refuse(&mut self, key: &str, problem: String, hint: &str) {
        self.first.get_or_insert(Invalid { key: key.to_owned(), problem, hint: hint.to_owned() });
    }

    /// The verdict.
    ///
    /// # Errors
    /// The first value that was refused.
    pub fn done(self) -> Result<(), Invalid> {
        self.first.map_or(Ok(()), Err)
    }
}
