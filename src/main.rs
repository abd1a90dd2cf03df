//! The `retroflex` program.

use retroflex::cli;
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run(cli::parse())
}
