//! The command line: one file for each command, and the exit codes.
//!
//! 0: done. 1: the run finished and its answer is "not good enough". 2: bad input or usage. 3: hardware or service not
//! reachable.

pub mod bench;
pub mod board;
pub mod calibrate;
pub mod client;
pub mod commission;
pub mod completions;
pub mod doctor;
pub mod drill;
pub mod evaluate;
pub mod gap;
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

pub use outcome::{CommandOutcome, Unreachable};

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::fmt::Write;
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
    Completions(completions::Args),
}

/// The commands by task, as `--help` lists them.
const GROUPS: [(&str, &[&str]); 7] = [
    ("Move", &["run", "arm", "bend", "stream", "play", "hold", "stop", "relax", "disarm", "status", "subscribe", "reset-fault", "reload"]),
    ("Bring up", &["board", "doctor", "release", "jog", "home", "commission", "bench"]),
    ("Calibrate", &["zero", "calibrate", "imu"]),
    ("Diagnose", &["record", "replay", "gap"]),
    ("Simulate", &["evaluate"]),
    ("Prove", &["drill"]),
    ("Other", &["completions", "help"]),
];

const HELP_TEMPLATE: &str = "{about-with-newline}\n{usage-heading} {usage}\n{after-help}\n\nOptions:\n{options}";

/// The command line as `clap` describes it, with the commands grouped by task.
#[must_use]
pub fn command() -> clap::Command {
    let cli = Cli::command();
    let mut text = String::new();
    for (task, names) in GROUPS {
        let _ = writeln!(text, "\n{task}:");
        for name in names {
            let about = cli
                .find_subcommand(name)
                .and_then(clap::Command::get_about)
                .map_or_else(|| "Print help for a command.".to_owned(), ToString::to_string);
            let _ = writeln!(text, "  {name:<13} {about}");
        }
    }
    cli.help_template(HELP_TEMPLATE).after_help(text.trim_end().to_owned())
}

/// Parses the arguments of the process; prints help or a usage error and exits where that is due.
#[must_use]
pub fn parse() -> Cli {
    Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|e| e.exit())
}

/// Runs a command and returns its exit code.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let end = match cli.command {
        Command::Evaluate(args) => evaluate::run(&args),
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
        Command::Completions(args) => Ok(completions::run(&args, command())),
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

    #[test]
    fn help_lists_every_command_once() {
        let mut listed: Vec<&str> = GROUPS.iter().flat_map(|g| g.1).copied().filter(|n| *n != "help").collect();
        let cli = Cli::command();
        let mut all: Vec<&str> = cli.get_subcommands().filter(|c| !c.is_hide_set()).map(clap::Command::get_name).collect();
        listed.sort_unstable();
        all.sort_unstable();
        assert_eq!(listed, all);
        command().debug_assert();
    }
}
