//! Range checks that remember which key they were about.

use std::ops::RangeInclusive;

/// A value that is not allowed.
#[derive(Debug, Clone, PartialEq)]
pub struct Invalid {
    /// Dotted key, an index for arrays: `transmission.k_epsilon.1`.
    pub key: String,
    /// What was found and what is allowed.
    pub problem: String,
    /// How to mend it.
    pub mend: String,
}

/// Collects the first thing that is wrong.
#[derive(Debug, Default)]
pub struct Checker {
    first: Option<Invalid>,
}

impl Checker {
    /// A number must lie in a range; NaN never does.
    pub fn range(&mut self, key: &str, value: f64, allowed: RangeInclusive<f64>, unit: &str, mend: &str) {
        if !allowed.contains(&value) {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            self.refuse(key, format!("{value}{unit} is outside {} to {}{unit}", allowed.start(), allowed.end()), mend);
        }
    }
    /// Each number of an array must lie in a range.
    pub fn ranges(&mut self, key: &str, values: &[f64], allowed: RangeInclusive<f64>, unit: &str, mend: &str) {
        for (i, &v) in values.iter().enumerate() {
            self.range(&format!("{key}.{i}"), v, allowed.clone(), unit, mend);
        }
    }
    /// A relation between values must hold.
    pub fn holds(&mut self, key: &str, good: bool, problem: &str, mend: &str) {
        if !good {
            self.refuse(key, problem.to_owned(), mend);
        }
    }
    /// A value is refused, whatever the reason.
    pub fn refuse(&mut self, key: &str, problem: String, mend: &str) {
        self.first.get_or_insert(Invalid { key: key.to_owned(), problem, mend: mend.to_owned() });
    }
    /// The verdict.
    ///
    /// # Errors
    /// The first value that was refused.
    pub fn done(self) -> Result<(), Invalid> {
        self.first.map_or(Ok(()), Err)
    }
}

/// A section that can judge itself.
pub trait Check {
    /// Reports every value that is out of its range.
    fn check(&self, to: &mut Checker);
}
