//! `retroflex gap excite`: designs a schedule on which effects can be told apart.

use crate::cli::CommandOutcome;
use crate::cli::gap::{PAPER, saved};
use crate::cli::output::{self, write};
use crate::diagnosis::excite::rows::csv;
use crate::diagnosis::excite::{APART, Designed, LONGEST_S, Wanted, design, separable};
use crate::model::transmission::Line;
use crate::primitives::{check::Checker, parameters::Check};
use comfy_table::{CellAlignment, Table, presets};
use miette::{Result, miette};
use std::path::PathBuf;
use std::time::Instant;

/// Schedules tried at most.
const ROUNDS: usize = 240;
/// The search ends after this long whatever the machine, s.
const SECONDS_MAX: f64 = 55.0;

/// Arguments of `gap excite`.
#[derive(Debug, clap::Args)]
pub struct ExciteArgs {
    /// Model kept by `gap diagnose --save`: its gains are used, and the effects that its log could not
    /// tell apart are separated first.
    #[arg(long, value_name = "MODEL.toml")]
    like: Option<PathBuf>,
    /// Schedule to write: rows `bend_deg,dir_deg,len_mm,hold_s,speed_mm_s`.
    #[arg(long, value_name = "SCHEDULE.csv")]
    out: PathBuf,
    /// A tracker (ref_q*) will be recorded too.
    #[arg(long)]
    tracker: bool,
    /// Seed of the search.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Schedules to try; fewer end sooner with a schedule less good.
    #[arg(long, default_value_t = ROUNDS)]
    rounds: usize,
}

impl Check for ExciteArgs {
    fn check(&self, to: &mut Checker) {
        to.range("--rounds", self.rounds as f64, 1.0..=100_000.0, "", "leave it out for the usual number");
    }
}

/// Designs and writes.
///
/// # Errors
/// A report that names what is wrong with the model or the output.
pub fn run(args: &ExciteArgs) -> Result<CommandOutcome> {
    let mut checker = Checker::default();
    args.check(&mut checker);
    checker.done().map_err(|e| miette!("{}: {}: {}", e.key, e.problem, e.hint))?;
    let like: Vec<&std::path::Path> = args.like.iter().map(PathBuf::as_path).collect();
    output::check(&[("--out", Some(&args.out))], &like)?;
    let like = args.like.as_deref().map(saved).transpose()?;
    let lines = like.as_ref().map_or(PAPER, |m| lines(&m.with_effects));
    let wanted = Wanted { lines, like, tracker: args.tracker, seed: args.seed, rounds: args.rounds };
    let (bar, begun) = (output::bar(args.rounds as u64, "{pos} of {len} schedules"), Instant::now());
    let designed = design(&wanted, &mut |tried| {
        bar.set_position(tried as u64);
        begun.elapsed().as_secs_f64() < SECONDS_MAX
    });
    bar.finish_and_clear();
    write(&args.out, &csv(&designed.rows))?;
    eprintln!("{}", summary(args, &designed));
    Ok(CommandOutcome::Good)
}

fn lines(g: &crate::diagnosis::saved::SavedGains) -> [Line; 3] {
    std::array::from_fn(|i| Line { k_epsilon: g.k_epsilon[i], k_lambda_mm: g.k_lambda_mm[i] })
}

fn summary(args: &ExciteArgs, d: &Designed) -> String {
    let mut table = Table::new();
    table.load_style(presets::UTF8_HORIZONTAL_ONLY);
    table.set_header(["nearest pairs", "", "here", "standard"]);
    for (a, b, here, there) in d.pairs().into_iter().filter(|p| separable(p.0, p.1, args.tracker)).take(8) {
        table.add_row([a.to_owned(), b.to_owned(), format!("{here:.1} σ"), format!("{there:.1} σ")]);
    }
    for column in table.column_iter_mut().skip(2) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    let near = |p: &&(&str, &str, f64, f64)| p.2 < APART || !separable(p.0, p.1, args.tracker);
    let lost: Vec<String> = d.pairs().iter().filter(near).map(|p| format!("{} and {}", p.0, p.1)).collect();
    let lost = match (lost.is_empty(), args.tracker) {
        (true, _) => "every pair in question is separated".to_owned(),
        (false, true) => format!("no motion found separates {}", lost.join("; ")),
        (false, false) => format!(
            "no motion found separates {}\n  an outside view may: record a tracker (ref_q*) and design with --tracker, or mount an IMU on the base (base_*)",
            lost.join("; ")
        ),
    };
    let cut = if d.tried < args.rounds { format!(" (stopped after {SECONDS_MAX} s)") } else { String::new() };
    format!(
        "{}: {} rows, {:.0} s of at most {LONGEST_S} s; seed {}, {} schedules tried{cut}\n{table}\n{lost}\n\
         next: run it after at least 2 s of rest, log it, and run `retroflex gap diagnose` on the log",
        args.out.display(),
        d.rows.len(),
        d.distances.duration_s,
        args.seed,
        d.tried
    )
}
