//! What a designed schedule separates, in words.

use crate::diagnosis::excite::{APART, Design, LONGEST_S, Pair, Request};
use crate::diagnosis::tip::separable;
use crate::report::table::table;
use std::path::Path;

/// Pairs in the table.
const SHOWN: usize = 8;

/// What a schedule separates; `out` is its file.
pub fn summary(out: &Path, request: &Request, d: &Design) -> String {
    let pairs = d.pairs();
    let within_reach = |p: &&Pair| separable(p.names[0], p.names[1], request.tracker);
    let row = |p: &Pair| {
        let [a, b] = p.names.map(str::to_owned);
        let [here, standard] = [p.designed, p.standard].map(|x| format!("{x:.1} σ"));
        [a, b, here, standard]
    };
    let shown = pairs.iter().filter(within_reach).take(SHOWN);
    let table = table("nearest pairs||here|standard", 2..4, shown.map(row));
    let near = |p: &&Pair| p.designed < APART || !within_reach(p);
    let lost = pairs.iter().filter(near);
    let lost: Vec<String> = lost.map(|p| p.names.join(" and ")).collect();
    let lost = match (lost.is_empty(), request.tracker) {
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
        out.display(),
        d.rows.len(),
        d.duration_s,
        request.seed,
        request.rounds
    )
}
