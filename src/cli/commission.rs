//! `retroflex commission`: verifies that the machine is wired as its board file says, and that its lines are tight.

use crate::cli::{manual_motion, output, within};
use crate::config::rewired::rewired;
use crate::config::{Board, source};
use crate::supervisor::commission::trial::{self, TrialConfig, TrialError};
use crate::supervisor::commission::wiring::Wiring;
use miette::{Result, bail, miette};
use std::path::{Path, PathBuf};

/// Arguments of `commission`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// Correct the board file where it differs from the machine.
    #[arg(long)]
    write: bool,
    /// Stroke of the wiring test, mm, 1 to 6.
    #[arg(long, default_value_t = 3.0, value_parser = within(1.0..=6.0, "mm"))]
    stroke: f64,
    /// Duration of the leak test of each line, s, up to 120; 0 skips it.
    #[arg(long, default_value_t = 10.0, value_parser = within(0.0..=120.0, "s"))]
    hold: f64,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or the reason that ended the procedure.
pub fn run(args: &Args) -> Result<bool> {
    let (board, mut machine) = manual_motion::open(&args.board, |_| ())?;
    let config = TrialConfig {
        geometry: board.geometry.law(),
        stroke_mm: args.stroke,
        hold_s: args.hold,
    };
    let report = |e| match e {
        TrialError::Motion(e) => manual_motion::motion_error(e),
        e => miette!("{e}"),
    };
    let findings = manual_motion::with_manual_control(machine.as_mut(), report, |hand| {
        trial::run(hand, &config, &mut |step| eprintln!("{step}"))
    })?;
    drop(machine);
    output::print(findings.report());
    if let (true, Some(wiring)) = (args.write, findings.wirings.first()) {
        write_back(&args.board, &board, wiring)?;
    }
    Ok(findings.is_good())
}

/// Writes the wiring that was found into the board file and keeps everything else as it is.
fn write_back(path: &Path, board: &Board, wiring: &Wiring) -> Result<()> {
    if wiring.is_right() {
        return Ok(());
    }
    let file = path.display();
    if !path.exists() {
        bail!(
            "{file} is a board of the program; write it into a file with `retroflex board show {file} >board.toml`, and give that file"
        );
    }
    let text = source::text_of(path)?;
    let (new, changes) = rewired(&text, board, wiring).map_err(|key| {
        miette!("{file}: {key} is not written in the file, so it cannot be changed there; copy its table from `retroflex board show` and run again")
    })?;
    source::parse::<Board>(&file.to_string(), &new)?;
    output::write(path, &new)?;
    for change in changes {
        eprintln!("{file}: {change}");
    }
    Ok(())
}
