//! Inputs that several commands share: configuration files with their built-in defaults, and foreign plants.

use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::{shipped, source};
use crate::primitives::parameters::Check;
use crate::simulation::link;
use miette::{Result, miette};
use serde::de::DeserializeOwned;
use std::ops::RangeInclusive;
use std::path::Path;

/// A board file; by default the paper twin.
///
/// # Errors
/// A report that names file, line and key.
pub fn board(path: Option<&Path>) -> Result<Board> {
    read_or(path, shipped::SIM)
}

/// A gains file; by default `boards/gains.toml`.
///
/// # Errors
/// A report that names file, line and key.
pub fn gains(path: Option<&Path>) -> Result<Gains> {
    read_or(path, shipped::GAINS)
}

/// A calibration file; by default the paper's gains.
///
/// # Errors
/// A report that names file, line and key.
pub fn calibration(path: Option<&Path>) -> Result<Calibration> {
    read_or(path, shipped::PAPER)
}

/// A file of any kind, or what comes with the program in its place.
///
/// # Errors
/// A report that names file, line and key.
pub fn read_or<T: DeserializeOwned + Check>(path: Option<&Path>, (name, built_in): (&str, &str)) -> Result<T> {
    Ok(match path {
        Some(path) => source::read(path)?,
        None => source::parse(name, built_in)?,
    })
}

/// A parser of options that take a number from a range.
pub fn within(allowed: RangeInclusive<f64>, unit: &'static str) -> impl Fn(&str) -> std::result::Result<f64, String> + Clone {
    move |text| match text.parse() {
        Ok(number) if allowed.contains(&number) => Ok(number),
        _ => Err(format!("expected a number from {} to {} {unit}", allowed.start(), allowed.end())),
    }
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
