//! What is said of a log: the probabilities of all statements, and the verdict.

pub mod decide;
pub mod posterior;
pub mod statements;

pub use decide::{StatementEntry, Verdict, VerdictKind, decide};
pub use posterior::{
    Claim, Head, Layout, Posterior, Said, Statement, conformal_set, exchanged, probabilities,
};
pub use statements::statements;
