//! The command line: one file for each command, and the exit codes.
//!
//! 0: done. 1: the run finished and its answer is "not good enough". 2: bad input or usage. 3: hardware or service not
//! reachable.

/// An enum of commands, each with its arguments and the function that runs it.
macro_rules! commands {
    (
        $(#[$about:meta])* $visible:vis enum $name:ident;
        $($(#[$help:meta])* $command:ident($arguments:ty) => $run:expr,)+
    ) => {
        $(#[$about])*
        #[derive(Debug, clap::Subcommand)]
        $visible enum $name {
            $($(#[$help])* $command($arguments),)+
        }

        impl $name {
            /// Runs the command.
            ///
            /// # Errors
            /// A report that says what is wrong with the input, the machine or the service.
            pub fn run(&self) -> miette::Result<$crate::cli::CommandOutcome> {
                match self {
                    $(Self::$command(arguments) => $run(arguments).map(Into::into),)+
                }
            }
        }
    };
}

pub mod accept;
pub mod bench;
pub mod board;
pub mod calibrate;
pub mod client;
pub mod commission;
pub mod demo;
pub mod doctor;
pub mod drill;
pub mod evaluate;
pub mod fleet;
pub mod flight;
pub mod foxglove;
pub mod gap;
pub mod help;
pub mod home;
pub mod imu;
pub mod inputs;
pub mod jog;
pub mod log;
pub mod logging;
pub mod manual_motion;
mod outcome;
pub mod output;
pub mod release;
pub mod replay;
pub mod run;

pub use inputs::within;
pub use outcome::{CommandOutcome, Refused, Unreachable};
pub use output::ResultFile;

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser};
use std::process::ExitCode;

/// Closed-loop bend control and gap diagnosis for a pneumatic endoscope tip.
///
/// For research. Not a medical device.
#[derive(Debug, Parser)]
#[command(name = "retroflex", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    #[arg(skip)]
    arguments: ArgMatches,
}

commands! {
    enum Command;

    /// Run the paper's experiment: open-loop arms and closed loop.
    Evaluate(evaluate::Args) => evaluate::run,
    /// Show the service and a leak of a simulated tip, cause to remedy.
    Demo(demo::Args) => demo::run,
    /// Run every step from a board file to a tip that bends.
    ///
    /// What they print becomes one report.
    Accept(accept::Args) => accept::run,
    /// Verify wiring and tightness with small guarded moves.
    Commission(commission::Args) => commission::run,
    /// Boards, gains and calibrations.
    #[command(subcommand)]
    Board(board::BoardCommand) => board::BoardCommand::run,
    /// Find the zero position of the pistons.
    Home(home::Args) => home::run,
    /// Move one piston slowly.
    Jog(jog::Args) => jog::run,
    /// Measure the timing of this computer.
    #[command(subcommand)]
    Bench(bench::Bench) => bench::Bench::run,
    /// Diagnose the gap between model and machine.
    #[command(subcommand)]
    Gap(gap::Gap) => gap::Gap::run,
    /// Compare the lots of a fleet and predict its next unit.
    ///
    /// Reads the rows of `gap diagnose --rows`.
    Fleet(fleet::Args) => fleet::run,
    /// Identify errors of the IMU, or the transmission.
    #[command(subcommand)]
    Calibrate(calibrate::Calibrate) => calibrate::Calibrate::run,
    /// Score orientation filters on recordings.
    #[command(subcommand)]
    Imu(imu::Imu) => imu::Imu::run,
    /// Run the control service.
    Run(run::Args) => run::run,
    #[command(flatten)]
    Client(client::Client) => client::Client::run,
    /// Compare this computer and its devices with the board file.
    Doctor(doctor::Args) => doctor::run,
    /// Inject every fault that the project claims to survive.
    Drill(drill::Args) => drill::run,
    /// Take the current away from all drivers.
    Release(release::Args) => release::run,
    /// Show a running service in Foxglove or Lichtblick.
    ///
    /// Serves the topics of the flight log while it is written.
    Foxglove(foxglove::Args) => foxglove::run,
    /// Show, export and cut flight logs.
    #[command(subcommand)]
    Log(log::Log) => log::Log::run,
    /// Run a recording through the loop and compare bit for bit.
    Replay(replay::Args) => replay::run,
    /// Print a completion script for a shell.
    Completions(help::CompletionsArgs) => |args: &_| help::completions(args, command()),
    /// Write the man pages into a folder.
    Man(help::ManArgs) => |args: &_| help::man(args, command()),
}

/// The command line as `clap` describes it.
pub fn command() -> clap::Command {
    help::explained(Cli::command())
}

/// Parses the arguments of the process; prints help or a usage error and exits where that is due.
pub fn parse() -> Cli {
    let parsed = command().try_get_matches().and_then(|arguments| {
        let cli = Cli::from_arg_matches(&arguments)?;
        Ok(Cli { arguments, ..cli })
    });
    parsed.unwrap_or_else(|e| {
        if !e.use_stderr() {
            output::print_with(|_| e.print());
            std::process::exit(0)
        }
        eprint!("{}", help::plain(&e.render().to_string()));
        std::process::exit(2)
    })
}

/// Runs a command and returns its exit code.
pub fn run(cli: Cli) -> ExitCode {
    output::exit_on_print_failure();
    let end = output::check_arguments(&cli.arguments).and_then(|()| cli.command.run());
    if let Err(report) = &end {
        outcome::print(report);
    }
    ExitCode::from(exit_code(&end))
}

fn exit_code(end: &miette::Result<CommandOutcome>) -> u8 {
    match end {
        Ok(CommandOutcome(good)) => u8::from(!good),
        Err(report) if report.chain().any(|e| e.is::<Refused>()) => 1,
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
        assert_eq!(exit_code(&Ok(CommandOutcome(true))), 0);
        assert_eq!(exit_code(&Ok(CommandOutcome(false))), 1);
        assert_eq!(exit_code(&Err(miette!("bad key"))), 2);
        assert_eq!(exit_code(&Err(Refused::report("not while disarmed"))), 1);
        let gone = || Unreachable::report("/dev/i2c-1", "no such file");
        assert_eq!(exit_code(&Err(gone())), 3);
        let deep: miette::Result<CommandOutcome> = Err(gone()).wrap_err("at start");
        assert_eq!(exit_code(&deep), 3);
    }

    #[test]
    fn help_lists_every_command_once() {
        let mut listed: Vec<&str> = help::GROUPS
            .iter()
            .flat_map(|g| g.1.split(' '))
            .filter(|n| *n != "help")
            .collect();
        let cli = Cli::command();
        let mut all: Vec<&str> = cli
            .get_subcommands()
            .filter(|c| !c.is_hide_set())
            .map(clap::Command::get_name)
            .collect();
        listed.sort_unstable();
        all.sort_unstable();
        assert_eq!(listed, all);
        command().debug_assert();
    }

    #[test]
    fn every_command_has_two_examples_that_parse() {
        for name in help::GROUPS
            .iter()
            .flat_map(|g| g.1.split(' '))
            .filter(|n| *n != "help")
        {
            for example in help::examples(name) {
                let words = std::iter::once("retroflex").chain(example.split(' '));
                assert!(example.starts_with(name), "{example}");
                command()
                    .try_get_matches_from(words)
                    .unwrap_or_else(|e| panic!("{example}: {e}"));
            }
        }
    }

    #[test]
    fn usage_errors_name_the_value_and_what_is_expected() {
        let message = |line: &str| {
            help::plain(
                &command()
                    .try_get_matches_from(line.split(' '))
                    .unwrap_err()
                    .render()
                    .to_string(),
            )
        };
        assert!(
            message("retroflex evaluate --seed -1")
                .contains("'-1' for '--seed <SEED>': expected a whole number, not negative")
        );
        assert!(message("retroflex bend x").contains("'x' for '<BEND>': expected a number"));
        for (line, words) in [
            ("evaluate --sweep --live", ["--live", "--sweep"]),
            ("evaluate --ablate --live", ["--live", "--ablate"]),
            (
                "gap exam --rounds 0",
                ["--rounds", "0 is not in 1 to 10000"],
            ),
            ("gap exam --every 0", ["--every", "0 is not in 1 to 10000"]),
            (
                "bench rt --load 100000",
                ["--load", "100000 is not in 0 to 1024"],
            ),
        ] {
            let message = message(&format!("retroflex {line}"));
            assert!(
                words.iter().all(|w| message.contains(w)),
                "{line}: {message}"
            );
        }
    }
}
