//! The flight log: an MCAP file (<https://mcap.dev>) with the exact input of the supervisor in every cycle, digests of its
//! decisions, and channels that any reader of MCAP can show.
//!
//! [`cycle`] and [`start`] hold what a replay needs, [`channels`] and [`scene`] what people look at, [`schema`] its form. [`mod@file`] writes
//! a file, [`mod@log`] a series of them in a thread of its own, [`read`] reads them. Every cycle has a number: a cycle that was
//! lost leaves a gap in the numbers.

pub mod channels;
pub mod cycle;
pub mod file;
pub mod log;
pub mod read;
pub mod scene;
pub mod schema;
pub mod start;
