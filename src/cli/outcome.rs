//! How a command ends: good, not good enough, or not reachable.

use std::fmt;

/// How a command ended, other than by an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandOutcome {
    /// Done.
    Good,
    /// The run finished, and its answer is "not good enough".
    NotGoodEnough,
}

impl From<()> for CommandOutcome {
    fn from((): ()) -> Self {
        Self::Good
    }
}

impl From<bool> for CommandOutcome {
    fn from(good: bool) -> Self {
        match good {
            true => Self::Good,
            false => Self::NotGoodEnough,
        }
    }
}

/// Hardware or a service that does not answer. Anywhere in the chain of a report it makes the exit code 3.
///
/// Convert it to a `Report` with `?` or `Report::from`; `into_diagnostic` would hide its type.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{what} cannot be reached: {why}")]
pub struct Unreachable {
    /// Which device, bus or service.
    pub what: String,
    /// The system's reason, and the remedy.
    pub why: String,
}

impl Unreachable {
    /// The report about a device, bus or service that does not answer.
    pub fn report(what: &str, why: impl ToString) -> miette::Report {
        let (what, why) = (what.to_owned(), why.to_string());
        Self { what, why }.into()
    }
}

/// A "no" that a command says in its own words on standard error: what the service refuses, or a motion that ended early. Anywhere in
/// the chain of a report it makes the exit code 1.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{0}")]
pub struct Refused(pub String);

impl Refused {
    /// The report of what is refused, and why.
    pub fn report(why: impl fmt::Display) -> miette::Report {
        Self(format!("refused: {why}")).into()
    }
}
