//! The command line: one file a command, one place for exit codes.
//!
//! 0 done · 1 the run finished and the answer is "not good enough" · 2 bad input or usage · 3 hardware
//! or service not reachable.

pub mod evaluate;
pub mod gap;
pub mod gap_diagnose;
pub mod gap_excite;
pub mod gap_map;
pub mod imu;
pub mod output;

use clap::{Parser, Subcommand};
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
    /// Diagnose the gap between model and machine.
    #[command(subcommand)]
    Gap(gap::Gap),
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

/// Hardware or a service that should be there and does not answer; anywhere in a report's chain it
/// makes the exit code 3. Raise it as a `Report` with `?` or `Report::from`; `into_diagnostic` would hide
/// what it is.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{what} cannot be reached: {why}")]
pub struct Unreachable {
    /// Which device, bus or service.
    pub what: String,
    /// The system's reason, and what to do about it.
    pub why: String,
}

/// Runs the command line and turns its end into an exit code.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let end = match cli.command {
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Gap(command) => gap::run(&command),
        Command::Imu(command) => imu::run(&command),
    };
    if let Err(report) = &end {
        eprintln!("{report:?}");
    }
    ExitCode::from(exit_code(&end))
}

fn exit_code(end: &miette::Result<Outcome>) -> u8 {
    match end {
        Ok(Outcome::Good) => 0,
        Ok(Outcome::NotGoodEnough) => 1,
        Err(report) if report.chain().any(|e| e.is::<Unreachable>()) => 3,
        Err(_) => 2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use miette::{WrapErr, miette};

    #[test]
    fn every_end_has_its_code() {
        assert_eq!(exit_code(&Ok(Outcome::Good)), 0);
        assert_eq!(exit_code(&Ok(Outcome::NotGoodEnough)), 1);
        assert_eq!(exit_code(&Err(miette!("bad key"))), 2);
        let gone = || Unreachable { what: "/dev/i2c-1".to_owned(), why: "no such file".to_owned() };
        assert_eq!(exit_code(&Err(gone().into())), 3);
        let deep: miette::Result<Outcome> = Err(miette::Report::from(gone())).wrap_err("at start");
        assert_eq!(exit_code(&deep), 3);
    }
}
