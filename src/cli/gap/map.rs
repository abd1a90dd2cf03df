//! `retroflex gap diagnose --map`: diagnoses a bench log of another rig.

use crate::cli::gap::input::file_name;
use crate::cli::output::{self, ResultFile};
use crate::config::source;
use crate::diagnosis::rig::{Document, MapFile, table};
use crate::report::gap::map::summary;
use miette::{IntoDiagnostic, Result};
use std::path::{Path, PathBuf};

/// Diagnoses a mapped log.
///
/// # Errors
/// A report that names file, line and column, or the key of the map.
pub fn run(
    log: &Path,
    map: &Path,
    fresh: &[PathBuf],
    json: &Option<ResultFile>,
    seed: u64,
) -> Result<()> {
    let map: MapFile = source::read(map)?;
    let signals = table::read(log, &map).into_diagnostic()?;
    let other = |path: &PathBuf| Ok((file_name(path), table::read(path, &map).into_diagnostic()?));
    let others = fresh.iter().map(other).collect::<Result<Vec<_>>>()?;
    let document = Document::new(&map, &signals, &others, seed);
    output::answer(json, &document, summary(&document) + "\n")
}
