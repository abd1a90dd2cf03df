//! The command line: one file a command, one place for exit codes.
//!
//! 0 done · 1 the run finished and the answer is "not good enough" · 2 bad input or usage · 3 hardware
//! or service not reachable.

pub mod calibrate;
pub mod evaluate;
pub mod imu;

use clap::{Parser, Subcommand};
use miette::{Result, miette};
use std::path::Path;
use std::process::ExitCode;

/// Closed-loop bend control and gap diagnosis for a disposable pneumatic endoscope tip.
///
/// For research. Not a medical device.
#[derive(Debug, Parser)]
#[command(name = "retroflex", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the paper's experiment: three open-loop arms and the closed loop.
    Evaluate(evaluate::Args),
    /// Find the errors of a sensor and write them into a calibration file.
    #[command(subcommand)]
    Calibrate(calibrate::Calibrate),
    /// Orientation filters on recordings.
    #[command(subcommand)]
    Imu(imu::Imu),
}

/// How a command ended, other than by an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done.
    Good,
    /// It ran to its end, and the answer is "not good enough".
    NotGoodEnough,
}

/// Runs the command line and turns its end into an exit code.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let end = match cli.command {
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Calibrate(command) => calibrate::run(&command),
        Command::Imu(command) => imu::run(&command),
    };
    match end {
        Ok(Outcome::Good) => ExitCode::SUCCESS,
        Ok(Outcome::NotGoodEnough) => ExitCode::from(1),
        Err(report) => {
            eprintln!("{report:?}");
            ExitCode::from(2)
        }
    }
}

/// Writes a file whole or not at all: beside its place first, then moved there.
///
/// # Errors
/// Names the file and the system's reason.
pub fn write_whole(path: &Path, text: &str) -> Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".part");
    std::fs::write(&beside, text)
        .and_then(|()| std::fs::rename(&beside, path))
        .map_err(|e| miette!("{}: cannot be written: {e}; give a path in a folder that exists and may be written", path.display()))
}
