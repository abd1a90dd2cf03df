//! The `retroflex` program: a table of contents.

use clap::Parser;
use retroflex::cli::{Cli, run};
use std::process::ExitCode;

fn main() -> ExitCode {
    run(Cli::parse())
}
