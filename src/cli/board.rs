//! `retroflex board show`: a file with everything that it leaves out.

use crate::cli::{CommandOutcome, inputs};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::{shipped, show};
use crate::primitives::parameters::{Check, Parameters};
use miette::Result;
use serde::de::DeserializeOwned;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Boards, gains and calibrations.
#[derive(Debug, clap::Subcommand)]
pub enum BoardCommand {
    /// Print a whole file as TOML, with the meaning, unit, default and range of every key.
    Show(ShowArgs),
}

/// Arguments of `board show`.
#[derive(Debug, clap::Args)]
pub struct ShowArgs {
    /// File, or the name of a board that comes with the program (`sim`, `pi4`, …); left out: the default file.
    file: Option<PathBuf>,
    /// The file holds gains.
    #[arg(long, conflicts_with = "calib")]
    gains: bool,
    /// The file holds a calibration.
    #[arg(long)]
    calib: bool,
}

/// Runs the command.
///
/// # Errors
/// A report on a file that cannot be used.
pub fn run(command: &BoardCommand) -> Result<CommandOutcome> {
    let BoardCommand::Show(args) = command;
    let file = args.file.as_deref();
    let text = if args.gains {
        page::<Gains>(file, shipped::GAINS)?
    } else if args.calib {
        page::<Calibration>(file, shipped::PAPER)?
    } else {
        let named = file.and_then(|f| f.to_str()).and_then(|name| shipped::BOARDS.into_iter().find(|(n, _)| *n == name));
        page::<Board>(file.filter(|_| named.is_none()), named.unwrap_or(shipped::SIM))?
    };
    // a reader that has gone away is no failure
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(CommandOutcome::Good)
}

/// A file, or what comes with the program in its place, as the whole of its keys.
fn page<T: DeserializeOwned + Check + Parameters>(file: Option<&Path>, own: (&str, &str)) -> Result<String> {
    Ok(show::whole(&inputs::read_or::<T>(file, own)?))
}
