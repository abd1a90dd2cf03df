//! `retroflex gap excite`: designs a schedule that separates effects.

use crate::cli::gap::input;
use crate::cli::{CommandOutcome, inputs, output};
use crate::diagnosis::excite::rows::csv;
use crate::diagnosis::excite::{APART, Design, LONGEST_S, Machine, Pair, Request, design};
use crate::diagnosis::tip::separable;
use crate::primitives::{Check, Checker};
use miette::{Result, miette};
use std::path::PathBuf;

/// Schedules evaluated by default.
const ROUNDS: usize = 240;
/// Pairs in the table.
const SHOWN: usize = 8;

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
    out: PathBuf,
    /// A tracker (ref_q*) will be recorded too.
    #[arg(long)]
    tracker: bool,
    /// Seed of the search.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Schedules to evaluate; fewer take less time and separate less.
    #[arg(long, default_value_t = ROUNDS)]
    rounds: usize,
}

impl Check for Args {
    fn check(&self, to: &mut Checker) {
        to.at("--rounds")
            .range(self.rounds as f64, 1.0..=100_000.0, "")
            .hint("leave it out for the default");
    }
}

/// Designs and writes.
///
/// # Errors
/// A report that names the faulty input.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    let mut checker = Checker::default();
    args.check(&mut checker);
    checker
        .done()
        .map_err(|e| miette!("{}: {}: {}", e.key, e.problem, e.hint))?;
    let read: Vec<&std::path::Path> = args
        .like
        .iter()
        .chain(&args.board)
        .map(PathBuf::as_path)
        .collect();
    output::check(&[("--out", Some(&args.out))], &read)?;
    let like = args.like.as_deref().map(input::saved).transpose()?;
    let lines = match &like {
        Some(model) => model.with_effects.lines(),
        None => inputs::calibration(None)?.lines(),
    };
    let machine = Machine::new(input::rig(args.board.as_deref())?, lines);
    let bar = output::bar(args.rounds as u64, "{pos} of {len} schedules");
    let request = Request {
        machine,
        like,
        tracker: args.tracker,
        seed: args.seed,
        rounds: args.rounds,
    };
    let designed = design(&request, &mut |tried| bar.set_position(tried as u64));
    bar.finish_and_clear();
    output::write(&args.out, csv(&designed.rows))?;
    output::show(&(summary(args, &designed) + "\n"), Some(&args.out));
    Ok(CommandOutcome::Good)
}

fn summary(args: &Args, d: &Design) -> String {
    let pairs = d.pairs();
    let within_reach = |p: &&Pair| separable(p.0, p.1, args.tracker);
    let row = |p: &Pair| {
        [
            p.0.to_owned(),
            p.1.to_owned(),
            format!("{:.1} σ", p.2),
            format!("{:.1} σ", p.3),
        ]
    };
    let table = output::table(
        &["nearest pairs", "", "here", "standard"],
        2..4,
        pairs.iter().filter(within_reach).take(SHOWN).map(row),
    );
    let near = |p: &&Pair| p.2 < APART || !separable(p.0, p.1, args.tracker);
    let lost: Vec<String> = pairs
        .iter()
        .filter(near)
        .map(|p| format!("{} and {}", p.0, p.1))
        .collect();
    let lost = match (lost.is_empty(), args.tracker) {
        (true, _) => "the schedule separates every pair in question".to_owned(),
        (false, true) => format!("the schedule does not separate {}", lost.join("; ")),
        (false, false) => format!(
            "the schedule does not separate {}\n  a tracker may: record one (ref_q*) and design with --tracker, or mount an IMU on the base (base_*)",
            lost.join("; ")
        ),
    };
    format!(
        "{}: {} rows, {:.0} s of at most {LONGEST_S} s; seed {}, {} schedules evaluated\n{table}\n{lost}\n\
         next: run it after at least 2 s of rest, log it, and run `retroflex gap diagnose` on the log",
        args.out.display(),
        d.rows.len(),
        d.distances.duration_s,
        args.seed,
        args.rounds
    )
}
