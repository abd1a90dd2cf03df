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
        let _ = match part.parse::<u32>() {
            Ok(index) => write!(out, "[{}]", u64::from(index) + 1),
            Err(_) => write!(out, "{dot}{part}"),
        };
        out
    })
}

/// A key whose value is being checked.
#[must_use = "`hint` ends the check"]
#[derive(Debug)]
pub struct At<'a> {
    checker: &'a mut Checker,
    key: String,
    problem: Option<String>,
}

impl At<'_> {
    /// A number must lie in a range; NaN never does.
    pub fn range(self, value: f64, allowed: RangeInclusive<f64>, unit: &str) -> Self {
        if allowed.contains(&value) {
            return self;
        }
        let space = if unit.is_empty() { "" } else { " " };
        let value = match value.abs() {
            0.0 | 1e-6..1e9 => value.to_string(),
            _ => format!("{value:e}"),
        };
        let (low, high) = (allowed.start(), allowed.end());
        let problem = format!("{value}{space}{unit} is outside {low} to {high}{space}{unit}");
        self.holds(false, &problem)
    }

    /// A relation between values must hold.
    pub fn holds(mut self, good: bool, problem: &str) -> Self {
        if !good {
            self.problem.get_or_insert(problem.to_owned());
        }
        self
    }

    /// Ends the check: says how to correct a value that is refused.
    pub fn hint(self, hint: &str) {
        if let Some(problem) = self.problem {
            self.checker.refuse(&self.key, problem, hint);
        }
    }
}

/// Keeps the first problem.
#[derive(Debug, Default)]
pub struct Checker {
    first: Option<Invalid>,
}

impl Checker {
    /// Checks the value of a key. Nothing is refused before [`At::hint`].
    pub fn at(&mut self, key: &str) -> At<'_> {
        At {
            checker: self,
            key: key.to_owned(),
            problem: None,
        }
    }

    /// Each number of an array must lie in a range.
    pub fn each(
        &mut self,
        key: &str,
        values: &[f64],
        allowed: &RangeInclusive<f64>,
        unit: &str,
        hint: &str,
    ) {
        for (i, value) in values.iter().enumerate() {
            let at = self.at(&format!("{key}.{i}"));
            at.range(*value, allowed.clone(), unit).hint(hint);
        }
    }

    /// Refuses a value.
    pub fn refuse(&mut self, key: &str, problem: String, hint: &str) {
        self.first.get_or_insert(Invalid {
            key: key.to_owned(),
            problem,
            hint: hint.to_owned(),
        });
    }

    /// The verdict.
    ///
    /// # Errors
    /// The first value that was refused.
    pub fn done(self) -> Result<(), Invalid> {
        self.first.map_or(Ok(()), Err)
    }
}
