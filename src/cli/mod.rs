//! The command line: one file a command, one place for exit codes.
//!
//! 0 done · 1 the run finished and the answer is "not good enough" · 2 bad input or usage · 3 hardware
//! or service not reachable.

pub mod bench;
pub mod calibrate;
pub mod client;
pub mod commission;
pub mod doctor;
pub mod drill;
pub mod evaluate;
pub mod exam;
pub mod gap;
pub mod gap_diagnose;
pub mod gap_excite;
pub mod gap_map;
pub mod home;
pub mod imu;
pub mod inputs;
pub mod jog;
pub mod logging;
pub mod manual_motion;
pub mod output;
pub mod replay;
pub mod run;

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
    /// Prove with small guarded moves that a machine is wired as its board file says, and tight.
    Commission(commission::Args),
    /// Find zero.
    Home(home::Args),
    /// Move one piston slowly, for bring-up.
    Jog(jog::Args),
    /// Measure this machine.
    #[command(subcommand)]
    Bench(bench::Bench),
    /// Diagnose the gap between model and machine.
    #[command(subcommand)]
    Gap(gap::Gap),
    /// Find the errors of a sensor and write them into a calibration file.
    #[command(subcommand)]
    Calibrate(calibrate::Calibrate),
    /// Orientation filters on recordings.
    #[command(subcommand)]
    Imu(imu::Imu),
    /// Run the service.
    Run(run::Args),
    #[command(flatten)]
    Client(client::Client),
    /// Hold the board file against this machine.
    Doctor(doctor::Args),
    /// Inject every fault that is claimed to be survived.
    Drill(drill::Args),
    /// Run a recording through the loop of today.
    Replay(replay::Args),
}

/// How a command ended, other than by an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandOutcome {
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
        Command::Commission(args) => commission::run(&args),
        Command::Home(args) => home::run(&args),
        Command::Jog(args) => jog::run(&args),
        Command::Bench(command) => bench::run(&command),
        Command::Gap(command) => gap::run(&command),
        Command::Calibrate(command) => calibrate::run(&command),
        Command::Imu(command) => imu::run(&command),
        Command::Run(args) => run::run(&args),
        Command::Client(command) => client::run(&command),
        Command::Doctor(args) => doctor::run(&args),
        Command::Drill(args) => drill::run(&args),
        Command::Replay(args) => replay::run(&args),
    };
    if let Err(report) = &end {
        eprintln!("{report:?}");
    }
    ExitCode::from(exit_code(&end))
}

fn exit_code(end: &miette::Result<CommandOutcome>) -> u8 {
    match end {
        Ok(CommandOutcome::Good) => 0,
        Ok(CommandOutcome::NotGoodEnough) => 1,
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
        assert_eq!(exit_code(&Ok(CommandOutcome::Good)), 0);
        assert_eq!(exit_code(&Ok(CommandOutcome::NotGoodEnough)), 1);
        assert_eq!(exit_code(&Err(miette!("bad key"))), 2);
        let gone = || Unreachable { what: "/dev/i2c-1".to_owned(), why: "no such file".to_owned() };
        assert_eq!(exit_code(&Err(gone().into())), 3);
        let deep: miette::Result<CommandOutcome> = Err(miette::Report::from(gone())).wrap_err("at start");
        assert_eq!(exit_code(&deep), 3);
    }
}
