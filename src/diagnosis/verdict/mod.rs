//! What is said of a log: the probabilities of all statements, and the verdict.

pub mod decide;
pub mod posterior;
pub mod statements;
