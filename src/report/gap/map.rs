//! The diagnosis of mapped logs of another rig, in words and as one page.

use crate::diagnosis::rig::document::{LogEntry, Parameter};
use crate::diagnosis::rig::operators::kind;
use crate::diagnosis::rig::{Document, Entry, RigProblem, Set};
use crate::diagnosis::verdict::VerdictKind;
use crate::report::gap::charts::{self, Ranked};
use crate::report::gap::words::{self, verdict};
use crate::report::{Page, table};

/// Effects in the table of the answer, and on the page.
const SHOWN: [usize; 2] = [6, 10];
/// Least rows of a shown trace, which takes a tenth of the logs.
const TRACE_ROWS: f64 = 200.0;
/// Columns of the table of effects.
const EFFECTS: &str = "effect|probability|before|after|closed|95 %|";
/// Columns of the table of logs.
const LOGS: &str = "log|recalibrated|explained";

/// The logs with the predictions of both models, row by row; empty if the nominal model is not determined.
#[derive(Debug, Clone, Default)]
pub struct Rows {
    /// Time, the logs one after the other; measured, recalibrated model, with effects. NaN where they were not scored.
    pub points: Vec<[f64; 4]>,
    /// What the inputs alone should cause, in the unit of the output; empty without inputs.
    pub nominal: Vec<f64>,
    /// Whether times are in seconds, and not in rows.
    pub clocked: bool,
}

impl Rows {
    /// The rows of a diagnosis.
    pub fn new(problem: &RigProblem<'_>, chosen: &Set) -> Self {
        let mut t: Vec<f64> = Vec::new();
        for log in problem.logs {
            let start = t.last().map_or(0.0, |end| end + log.t[1] - log.t[0]);
            t.extend(log.t.iter().map(|at| start + at - log.t[0]));
        }
        let (logs, base) = (problem.logs.iter(), &problem.base);
        let y: Vec<f64> = logs.flat_map(|log| log.output.iter().copied()).collect();
        let [was, is] = [&problem.nominal, chosen].map(|set| problem.left_out(set));
        let point = |k: usize| [t[k], y[k], y[k] - was[k], y[k] - is[k]];
        let driven = base.drives.iter().filter(|_| problem.map.input.is_some());
        let nominal = driven
            .flat_map(|d| &d.v)
            .map(|v| base.scale.middle + base.scale.half * v);
        Self {
            points: (0..y.len()).map(point).collect(),
            nominal: nominal.collect(),
            clocked: problem.logs[0].clocked,
        }
    }

    /// The residual over time and over the nominal prediction, and the signal where the nominal model errs most.
    fn charts(&self, unit: &str) -> Vec<(String, String)> {
        let [Some(first), Some(last)] = [self.points.first(), self.points.last()] else {
            return vec![];
        };
        let time = if self.clocked { "time / s" } else { "row" };
        let residuals = |title, label: &str, x: &dyn Fn(usize) -> f64| {
            let left = |(k, [_, y, was, is]): (usize, &[f64; 4])| [x(k), y - was, y - is];
            let all = self.points.iter().enumerate();
            charts::residuals(title, label, unit, all.map(left))
        };
        let mut out = vec![residuals("Residual over time", time, &|k| {
            self.points[k][0]
        })];
        if !self.nominal.is_empty() {
            let label = format!("nominal prediction / {unit}");
            let nominal = |k: usize| self.nominal[k];
            out.push(residuals("Residual over the input", &label, &nominal));
        }
        let rows = self.points.len() as f64;
        let window = (last[0] - first[0]) * (TRACE_ROWS / rows).clamp(0.1, 1.0);
        let (label, output) = ("Measured and predicted", format!("output / {unit}"));
        let drawn = charts::trace(label, &self.points, window, time, &output);
        let caption = "Where the error of the recalibrated model is largest.".to_owned();
        out.extend(drawn.map(|chart| (chart.svg(), caption)));
        out
    }
}

/// The answer.
pub fn summary(d: &Document) -> String {
    let mut out = vec![opening(d)];
    out.extend(said(d));
    if let [_, _, ..] = d.logs.as_slice() {
        let rows = d.logs.iter().map(log_row);
        out.push(table(LOGS, 1..3, rows).to_string());
    }
    let sets = d.set.iter().filter(|_| d.verdict.names.len() > 1);
    let shown = sets.chain(d.effects.iter().take(SHOWN[0])).map(row);
    out.push(table(EFFECTS, 1..6, shown).to_string());
    out.join("\n")
}

fn log_row(log: &LogEntry) -> [String; 3] {
    let [before, after] = [log.recalibrated, log.explained].map(words::short);
    [log.file.clone(), before, after]
}

fn row(e: &Entry) -> [String; 7] {
    let param = |p: &Parameter| format!("{} {}", p.name, words::short(p.value));
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
}

/// What stands below the first sentence.
fn said(d: &Document) -> Vec<String> {
    // whether the log can tell anything comes before what it tells
    let mut out: Vec<String> = d.notes.iter().map(|n| format!("note: {n}")).collect();
    let unit = &d.unit;
    out.extend([
        verdict(&d.verdict),
        format!(
            "RMSE {:.4} {unit} nominal, {:.4} explained, {:.4} noise, on parts of the log that the fit has not seen",
            d.gap.recalibrated, d.gap.explained, d.gap.noise_floor
        ),
    ]);
    out.extend(closed(d).map(|share| format!("closed {share}")));
    let param = |p: &Parameter| {
        let ([low, high], value) = (p.ci95.map(words::short), words::short(p.value));
        format!("{}: {} {value} ({low} to {high})", p.of, p.name)
    };
    out.extend(
        d.set
            .first()
            .iter()
            .flat_map(|set| set.params.iter().map(param)),
    );
    let (p, rmse) = (d.unknown.probability, d.unknown.rmse);
    out.push(format!("unknown {p:.2}, {rmse:.4} {unit} above the noise"));
    out.extend(d.verdict.equivalent.iter().map(|g| group(g)));
    out
}

/// The page; `source` names the logs, and `made` states what it was made from and with, by name.
pub fn page(source: &str, d: &Document, rows: &Rows, made: &[[String; 2]]) -> String {
    let mut page = Page::new(&format!("Gap diagnosis: {source}"));
    page.text(&opening(d));
    said(d).iter().for_each(|line| page.text(line));
    page.quiet("Recalibration identifies the nominal model on these logs; what it closes is not credited to an effect.");
    if let [_, _, ..] = d.logs.as_slice() {
        page.table(LOGS, d.logs.iter().map(log_row));
    }
    page.heading("Where");
    page.charts(rows.charts(&d.unit));
    page.heading("Which");
    let shown = || d.effects.iter().take(SHOWN[1]);
    let ranked = |e: &Entry| Ranked {
        name: words::plain(&e.name),
        probability: e.probability,
        closed: (e.closed, e.closed_ci95),
        strong: d.verdict.speaks_of(&e.name),
    };
    page.charts(charts::ranking(&shown().map(ranked).collect::<Vec<_>>()));
    let sets = d.set.iter().filter(|_| d.verdict.names.len() > 1);
    page.table(EFFECTS, sets.chain(shown()).map(row));
    page.made_from(made, "docs/other-rigs.md");
    page.html()
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
            format!(
                "Cause: {closing}; confirm it: `--save model.toml`, then `retroflex gap check model.toml FRESH` on another log."
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
    let (kinds, names) = (kinds.join(" or "), names.join(", "));
    format!("{kinds}: this log cannot separate {names}")
}
