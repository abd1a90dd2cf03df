//! `retroflex board`: a file with everything that it leaves out, and whether a board is safe to run.

use crate::cli::{CommandOutcome, inputs, output};
use crate::config::board::Board;
use crate::config::calib::Calibration;
use crate::config::gains::Gains;
use crate::config::pressure_bound::PressureBound;
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
    /// Check a board: its file, and that the pressure stays bounded if the program fails.
    Check(CheckArgs),
}

/// Arguments of `board check`.
#[derive(Debug, clap::Args)]
pub struct CheckArgs {
    /// Board file, or the name of a board that comes with the program.
    board: PathBuf,
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
    let args = match command {
        BoardCommand::Show(args) => args,
        BoardCommand::Check(args) => return check(&args.board),
    };
    let file = args.file.as_deref();
    let text = if args.gains {
        page::<Gains>(file, shipped::GAINS)?
    } else if args.calib {
        page::<Calibration>(file, shipped::PAPER)?
    } else {
        let (file, own) = named(file);
        page::<Board>(file, own)?
    };
    // a reader that has gone away is no failure
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(CommandOutcome::Good)
}

/// A board file, or the shipped board of that name in its place.
fn named(file: Option<&Path>) -> (Option<&Path>, (&'static str, &'static str)) {
    let own = file.and_then(|f| f.to_str()).and_then(|name| shipped::BOARDS.into_iter().find(|(n, _)| *n == name));
    (file.filter(|_| own.is_none()), own.unwrap_or(shipped::SIM))
}

/// Exit code 1 if nothing outside the program bounds the pressure.
fn check(path: &Path) -> Result<CommandOutcome> {
    let (file, own) = named(Some(path));
    let board: Board = inputs::read_or(file, own)?;
    let bound = PressureBound::of(&board);
    output::print(&format!("file      consistent\npressure  {bound}\n"));
    Ok(if bound.is_bounded() { CommandOutcome::Good } else { CommandOutcome::NotGoodEnough })
}

/// A file, or what comes with the program in its place, as the whole of its keys.
fn page<T: DeserializeOwned + Check + Parameters>(file: Option<&Path>, own: (&str, &str)) -> Result<String> {
    Ok(show::whole(&inputs::read_or::<T>(file, own)?))
}
