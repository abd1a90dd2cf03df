//! What the rows about the process need.

use crate::drill::bench::BenchConfig;
use std::path::Path;

/// What the rows about the process need.
#[derive(Clone, Copy)]
pub struct Plan<'a> {
    /// The simulated machine.
    pub config: &'a BenchConfig,
    /// This program.
    pub program: &'a Path,
    /// An empty folder.
    pub scratch: &'a Path,
    /// Kills of the process.
    pub kills: u32,
    /// Stops under each attack.
    pub tries: u32,
    /// Whether a row is wanted.
    pub selected: &'a dyn Fn(&str) -> bool,
}
