//! From samples to the tip's attitude: which samples may be believed, and what they say together.

pub mod health;
