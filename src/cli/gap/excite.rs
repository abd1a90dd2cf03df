//! `retroflex gap excite`: designs a schedule that separates effects.

use crate::cli::gap::input;
use crate::cli::{ResultFile, inputs, output};
use crate::diagnosis::excite::rows::csv;
use crate::diagnosis::excite::{Machine, Request, design};
use crate::report::gap::schedule::summary;
use miette::Result;
use std::path::PathBuf;

/// Arguments of `gap excite`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Model saved by `gap diagnose --save`: its gains are used, and the effects that its log could not separate are
    /// separated first.
    #[arg(long, value_name = "MODEL.toml")]
    like: Option<PathBuf>,
    /// Board file of the machine; default: the machine of the paper.
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Schedule to write: rows `bend_deg,dir_deg,len_mm,hold_s,speed_mm_s`.
    #[arg(long, value_name = "SCHEDULE.csv")]
    out: ResultFile,
    /// A tracker (ref_q*) will be recorded too.
    #[arg(long)]
    tracker: bool,
    /// Seed of the search.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Schedules to evaluate; fewer take less time and separate less.
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rounds: u32,
}

/// Designs and writes.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<()> {
    let like = args.like.as_deref().map(inputs::tip_model).transpose()?;
    let lines = match &like {
        Some(model) => model.with_effects.lines(),
        None => inputs::calibration(None)?.lines(),
    };
    let bar = output::bar(args.rounds.into(), "{pos} of {len} schedules");
    let request = Request {
        machine: Machine::new(input::rig(args.board.as_deref())?, lines),
        like,
        tracker: args.tracker,
        seed: args.seed,
        rounds: args.rounds as usize,
    };
    let designed = design(&request, &mut |tried| bar.set_position(tried as u64));
    bar.finish_and_clear();
    output::write(&args.out, csv(&designed.rows))?;
    let text = summary(&args.out, &request, &designed) + "\n";
    output::show(text, &Some(args.out.clone()));
    Ok(())
}
