//! `retroflex gap diagnose --map`: diagnoses a bench log of another rig.

use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::config::source;
use crate::diagnosis::rig::operators::kind;
use crate::diagnosis::rig::{Document, Entry, MapFile, table};
use crate::diagnosis::verdict::VerdictKind;
use miette::{IntoDiagnostic, Result};
use std::path::{Path, PathBuf};

/// Diagnoses a mapped log.
///
/// # Errors
/// A report that names file, line and column, or the key of the map.
pub fn run(
    log: &Path,
    map: &Path,
    fresh: &[PathBuf],
    json: Option<&Path>,
    seed: u64,
) -> Result<CommandOutcome> {
    let map: MapFile = source::read(map)?;
    let signals = table::read(log, &map).into_diagnostic()?;
    let name = |p: &PathBuf| {
        p.file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned())
    };
    let others = fresh
        .iter()
        .map(|p| table::read(p, &map).map(|s| (name(p), s)).into_diagnostic())
        .collect::<Result<Vec<_>>>()?;
    let document = Document::new(&map, &signals, &others, seed);
    output::json(json, &document)?;
    output::show(&(summary(&document) + "\n"), json);
    Ok(CommandOutcome::Good)
}

fn summary(d: &Document) -> String {
    let row = |e: &Entry| {
        let params: Vec<String> = e
            .params
            .iter()
            .map(|p| format!("{} {:.4}", p.name, p.value))
            .collect();
        [
            e.name.clone(),
            format!("{:.2}", e.probability),
            format!("{:.4}", e.rmse_before),
            format!("{:.4}", e.rmse_after),
            format!("{:.0} %", e.closed * 100.0),
            format!(
                "{:.0} to {:.0} %",
                e.closed_ci95[0] * 100.0,
                e.closed_ci95[1] * 100.0
            ),
            params.join(", "),
        ]
    };
    let sets = d.set.iter().filter(|_| d.verdict.names.len() > 1);
    let table = output::table(
        &[
            "effect",
            "probability",
            "before",
            "after",
            "closed",
            "95 %",
            "",
        ],
        1..6,
        sets.chain(d.effects.iter().take(6)).map(row),
    );
    let names = if d.verdict.names.is_empty() {
        String::new()
    } else {
        format!(": {}", d.verdict.names.join(" and "))
    };
    let mut out = vec![opening(d)];
    // whether the log can tell anything comes before what it tells
    out.extend(d.notes.iter().map(|n| format!("note: {n}")));
    out.extend([
        format!("verdict {}{names}", d.verdict.kind.name()),
        format!(
            "RMSE {:.4} {} nominal, {:.4} explained, {:.4} noise, on parts of the log that the fit has not seen",
            d.gap.recalibrated, d.unit, d.gap.explained, d.gap.noise_floor
        ),
    ]);
    out.extend(d.set.first().map(|s| {
        let [low, high] = s.closed_ci95.map(|c| c * 100.0);
        format!(
            "closed {:.0} % of the gap (95 %: {low:.0} to {high:.0} %)",
            s.closed * 100.0
        )
    }));
    out.push(format!(
        "unknown {:.2}, {:.4} {} above the noise",
        d.unknown.probability, d.unknown.rmse, d.unit
    ));
    out.extend(d.verdict.equivalent.iter().map(|g| group(g)));
    out.extend(d.fresh.iter().map(|f| {
        format!(
            "on {}, without a new fit: {:.4} before, {:.4} after",
            f.log, f.before, f.after
        )
    }));
    out.push(table.to_string());
    out.join("\n")
}

/// The verdict in one sentence: cause, share of the gap, certainty, what to do next.
fn opening(d: &Document) -> String {
    let sure = format!("probability {:.2}", d.verdict.probability);
    let one = |name: &&'static str| {
        let group = d.verdict.equivalent.iter().find(|g| g[0] == *name);
        group.map_or_else(
            || (*name).to_owned(),
            |g| format!("either {}", g.join(" or ")),
        )
    };
    let names = d
        .verdict
        .names
        .iter()
        .map(one)
        .collect::<Vec<_>>()
        .join(" and ");
    let closed = d.set.first().map_or_else(String::new, |s| {
        let [low, high] = s.closed_ci95.map(|c| 100.0 * c);
        format!(
            "{:.0} % of the gap (95 %: {low:.0} to {high:.0} %)",
            100.0 * s.closed
        )
    });
    let close = if d.verdict.names.len() > 1 {
        "close"
    } else {
        "closes"
    };
    match (d.verdict.kind, d.verdict.equivalent.first()) {
        (VerdictKind::None, _) => format!("No effect ({sure}): the nominal model suffices."),
        (VerdictKind::Unknown, _) if names.is_empty() => {
            format!(
                "Unknown cause ({sure}): no known effect explains what remains; look for what it goes with."
            )
        }
        (VerdictKind::Unknown, _) => {
            format!(
                "Unknown cause ({sure}), of which {names} {close} {closed}; look for what the rest goes with."
            )
        }
        (VerdictKind::Effects, Some(group)) => {
            format!(
                "Cause: {names}, which {close} {closed} ({sure}); record a log that tells them apart: {}.",
                separated(group)
            )
        }
        (VerdictKind::Effects, None) => {
            format!(
                "Cause: {names}, which {close} {closed} ({sure}); confirm it with `--fresh` on another log."
            )
        }
    }
}

/// The motion that tells what a group has in common from other kinds, and its members from each other.
fn separated(names: &[&str]) -> &'static str {
    match kind(names[0]) {
        "memory of the path" => "nested loops of several sizes, slow and fast",
        "memory of the time" => "steps of several sizes and a chirp",
        "curved characteristic" => "several amplitudes to both sides",
        "period" => "the same travel at two speeds",
        _ => "the same motion repeated later",
    }
}

/// A group of effects that a log cannot separate, in words.
fn group(names: &[&str]) -> String {
    let mut kinds: Vec<&str> = names.iter().map(|n| kind(n)).collect();
    kinds.sort_unstable();
    kinds.dedup();
    format!(
        "{}: this log cannot separate {}",
        kinds.join(" or "),
        names.join(", ")
    )
}
