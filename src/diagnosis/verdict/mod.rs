//! What is said of a log: the probabilities of all statements, and the verdict.

pub mod decide;
pub mod posterior;

pub use decide::{StatementEntry, Verdict, VerdictKind, decide};
pub use posterior::{Claim, Feature, Head, Posterior, Said, Statement, exchanged, probabilities};
