//! The diagnosis of a mapped log of another rig in words.

use crate::diagnosis::rig::document::Parameter;
use crate::diagnosis::rig::operators::kind;
use crate::diagnosis::rig::{Document, Entry};
use crate::diagnosis::verdict::VerdictKind;
use crate::report::gap::words::verdict;
use crate::report::table::table;

/// The answer.
pub fn summary(d: &Document) -> String {
    let row = |e: &Entry| {
        let param = |p: &Parameter| format!("{} {:.4}", p.name, p.value);
        let [low, high] = e.closed_ci95.map(|share| share * 100.0);
        [
            e.name.clone(),
            format!("{:.2}", e.probability),
            format!("{:.4}", e.rmse_before),
            format!("{:.4}", e.rmse_after),
            format!("{:.0} %", e.closed * 100.0),
            format!("{low:.0} to {high:.0} %"),
            e.params.iter().map(param).collect::<Vec<_>>().join(", "),
        ]
    };
    let sets = d.set.iter().filter(|_| d.verdict.names.len() > 1);
    let shown = sets.chain(d.effects.iter().take(6)).map(row);
    let table = table("effect|probability|before|after|closed|95 %|", 1..6, shown);
    let (mut out, unit) = (vec![opening(d)], &d.unit);
    // whether the log can tell anything comes before what it tells
    out.extend(d.notes.iter().map(|n| format!("note: {n}")));
    out.extend([
        verdict(&d.verdict),
        format!(
            "RMSE {:.4} {unit} nominal, {:.4} explained, {:.4} noise, on parts of the log that the fit has not seen",
            d.gap.recalibrated, d.gap.explained, d.gap.noise_floor
        ),
    ]);
    out.extend(closed(d).map(|share| format!("closed {share}")));
    let (p, rmse) = (d.unknown.probability, d.unknown.rmse);
    out.push(format!("unknown {p:.2}, {rmse:.4} {unit} above the noise"));
    out.extend(d.verdict.equivalent.iter().map(|g| group(g)));
    out.extend(d.fresh.iter().map(|f| {
        let (log, before, after) = (&f.log, f.before, f.after);
        format!("on {log}, without a new fit: {before:.4} before, {after:.4} after")
    }));
    out.push(table.to_string());
    out.join("\n")
}

/// What the named effects close together.
fn closed(d: &Document) -> Option<String> {
    let set = d.set.first()?;
    let [low, high] = set.closed_ci95.map(|share| 100.0 * share);
    let share = format!("{:.0} % of the gap", 100.0 * set.closed);
    Some(format!("{share} (95 %: {low:.0} to {high:.0} %)"))
}

/// The verdict in one sentence: cause, share of the gap, certainty, what to do next.
fn opening(d: &Document) -> String {
    let sure = format!("probability {:.2}", d.verdict.probability);
    let one = |name: &&'static str| {
        let group = d.verdict.equivalent.iter().find(|group| group[0] == *name);
        let choice = group.map(|group| format!("either {}", group.join(" or ")));
        choice.unwrap_or((*name).to_owned())
    };
    let names: Vec<String> = d.verdict.names.iter().map(one).collect();
    let close = if names.len() > 1 { "close" } else { "closes" };
    let (names, closed) = (names.join(" and "), closed(d).unwrap_or_default());
    let closing = format!("{names}, which {close} {closed} ({sure})");
    match (d.verdict.kind, d.verdict.equivalent.first()) {
        (VerdictKind::None, _) => format!("No effect ({sure}): the nominal model suffices."),
        (VerdictKind::Unknown, _) if names.is_empty() => format!(
            "Unknown cause ({sure}): no known effect explains what remains; look for what it goes with."
        ),
        (VerdictKind::Unknown, _) => format!(
            "Unknown cause ({sure}), of which {names} {close} {closed}; look for what the rest goes with."
        ),
        (VerdictKind::Effects, Some(group)) => format!(
            "Cause: {closing}; record a log that tells them apart: {}.",
            separated(group)
        ),
        (VerdictKind::Effects, None) => {
            format!("Cause: {closing}; confirm it with `--fresh` on another log.")
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
    let (kinds, names) = (kinds.join(" or "), names.join(", "));
    format!("{kinds}: this log cannot separate {names}")
}
