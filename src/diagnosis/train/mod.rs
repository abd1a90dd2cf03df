//! Training of the probabilities of a diagnosis ([`crate::diagnosis::posterior`]).
//!
//! Units run the catalogue's laws, each multiplied by a random function of the pistons and the time, with small effects of every kind
//! beside them, or a random law that the catalogue lacks. The exam ([`crate::diagnosis::exam`]) asks about the built-in plant, which has
//! laws of its own.

pub mod case;
pub mod deform;
pub mod fit;
pub mod unit;
