//! `retroflex completions SHELL`: a completion script on standard output.

use crate::cli::{CommandOutcome, output};
use clap_complete::Shell;

/// Arguments of `completions`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Shell that the script is for.
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs the command; `command` is the whole command line.
#[must_use]
pub fn run(args: &Args, mut command: clap::Command) -> CommandOutcome {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "retroflex", &mut script);
    output::print(&String::from_utf8_lossy(&script));
    CommandOutcome::Good
}
