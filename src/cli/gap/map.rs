//! `retroflex gap diagnose --map`: diagnoses a bench log of another rig.

use crate::cli::CommandOutcome;
use crate::cli::output;
use crate::config::source;
use crate::diagnosis::map::diagnose::diagnose;
use crate::diagnosis::map::document::{Document, Entry};
use crate::diagnosis::map::file::MapFile;
use crate::diagnosis::map::operators::kind;
use crate::diagnosis::map::table;
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
    let document = diagnose(&map, &signals, &others, seed);
    output::json(json, &document)?;
    eprintln!("{}", summary(&document));
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
    let sets = d.set.iter().filter(|s| s.name.contains('+'));
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
    let mut out = vec![
        format!("verdict {}{names}", d.verdict.kind.name()),
        format!(
            "RMSE {:.4} {} nominal, {:.4} explained, {:.4} noise, on parts of the log that the fit has not seen",
            d.gap.recalibrated, d.unit, d.gap.explained, d.gap.noise_floor
        ),
    ];
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
    out.extend(d.notes.iter().map(|n| format!("note: {n}")));
    out.extend(d.fresh.iter().map(|f| {
        format!(
            "on {}, without a new fit: {:.4} before, {:.4} after",
            f.log, f.before, f.after
        )
    }));
    out.push(table.to_string());
    out.join("\n")
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
