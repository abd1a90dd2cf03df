//! Inputs that several commands share: configuration files with their built-in defaults, and foreign plants.

use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::source;
use crate::primitives::check::Check;
use crate::simulation::link;
use miette::{Result, miette};
use serde::de::DeserializeOwned;
use std::path::Path;

/// A board file; by default the paper twin.
///
/// # Errors
/// A report that names file, line and key.
pub fn board(path: Option<&Path>) -> Result<Board> {
    read_or(path, "boards/sim.toml", include_str!("../../boards/sim.toml"))
}

/// A gains file; by default `boards/gains.toml`.
///
/// # Errors
/// A report that names file, line and key.
pub fn gains(path: Option<&Path>) -> Result<Gains> {
    read_or(path, "boards/gains.toml", include_str!("../../boards/gains.toml"))
}

/// A calibration file; by default the paper's gains.
///
/// # Errors
/// A report that names file, line and key.
pub fn calibration(path: Option<&Path>) -> Result<Calibration> {
    read_or(path, "calib/paper.toml", include_str!("../../calib/paper.toml"))
}

fn read_or<T: DeserializeOwned + Check>(path: Option<&Path>, name: &str, built_in: &str) -> Result<T> {
    Ok(match path {
        Some(path) => source::read(path)?,
        None => source::parse(name, built_in)?,
    })
}

/// Program and arguments of `--plant 'exec:PROGRAM ARG…'`.
///
/// # Errors
/// A report that says what is missing.
pub fn program(plant: &str) -> Result<(String, Vec<String>)> {
    let line = plant.strip_prefix("exec:").ok_or_else(|| miette!("--plant `{plant}`: expected `exec:PROGRAM ARG…`"))?;
    let mut words = link::words(line).map_err(|why| miette!("--plant `{plant}`: {why}"))?.into_iter();
    let program = words.next().ok_or_else(|| miette!("--plant `{plant}`: no program is named after `exec:`"))?;
    Ok((program, words.collect()))
}
