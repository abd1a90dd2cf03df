//! The command line: one file for each command, and the exit codes.
//!
//! 0: done. 1: the run finished and its answer is "not good enough". 2: bad input or usage. 3: hardware or service not
//! reachable.

pub mod bench;
pub mod board;
pub mod calibrate;
pub mod client;
pub mod commission;
pub mod demo;
pub mod doctor;
pub mod drill;
pub mod evaluate;
pub mod gap;
pub mod help;
pub mod home;
pub mod imu;
pub mod inputs;
pub mod jog;
pub mod logging;
pub mod manual_motion;
mod outcome;
pub mod output;
pub mod release;
pub mod replay;
pub mod run;

pub use help::parse;
pub use outcome::{CommandOutcome, Unreachable};

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
    /// Run the paper's experiment: the open-loop arms and the closed loop.
    Evaluate(evaluate::Args),
    /// Show the service, a leak of a simulated tip, its diagnosis and its remedy, in less than two minutes.
    Demo(demo::Args),
    /// Verify the wiring and the tightness of a machine with small guarded moves.
    Commission(commission::Args),
    /// Boards, gains and calibrations.
    #[command(subcommand)]
    Board(board::BoardCommand),
    /// Find the zero position of the pistons.
    Home(home::Args),
    /// Move one piston slowly.
    Jog(jog::Args),
    /// Measure the timing of this computer.
    #[command(subcommand)]
    Bench(bench::Bench),
    /// Diagnose the gap between model and machine.
    #[command(subcommand)]
    Gap(gap::Gap),
    /// Identify the errors of the IMU, or the transmission of a running service.
    #[command(subcommand)]
    Calibrate(calibrate::Calibrate),
    /// Score orientation filters on recordings.
    #[command(subcommand)]
    Imu(imu::Imu),
    /// Run the control service.
    Run(run::Args),
    #[command(flatten)]
    Client(client::Client),
    /// Compare this computer and its devices with the board file.
    Doctor(doctor::Args),
    /// Inject every fault that the project claims to survive.
    Drill(drill::Args),
    /// Take the current away from all drivers.
    Release(release::Args),
    /// Run a recording through the current control loop and compare bit for bit.
    Replay(replay::Args),
    /// Print a completion script for a shell.
    Completions(help::CompletionsArgs),
    /// Write the man pages into a folder.
    Man(help::ManArgs),
}

/// Runs a command and returns its exit code.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let end = match cli.command {
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Commission(args) => commission::run(&args),
        Command::Board(command) => board::run(&command),
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
        Command::Release(args) => release::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Completions(args) => Ok(help::completions(&args)),
        Command::Man(args) => help::man(&args),
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
    fn every_outcome_has_its_exit_code() {
        assert_eq!(exit_code(&Ok(CommandOutcome::Good)), 0);
        assert_eq!(exit_code(&Ok(CommandOutcome::NotGoodEnough)), 1);
        assert_eq!(exit_code(&Err(miette!("bad key"))), 2);
        let gone = || Unreachable { what: "/dev/i2c-1".to_owned(), why: "no such file".to_owned() };
        assert_eq!(exit_code(&Err(gone().into())), 3);
        let deep: miette::Result<CommandOutcome> = Err(miette::Report::from(gone())).wrap_err("at start");
        assert_eq!(exit_code(&deep), 3);
    }
}
