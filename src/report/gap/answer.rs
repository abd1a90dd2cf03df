//! A diagnosis in words and tables.

use crate::diagnosis::tip::{Diagnosis, EffectEntry, LogEntry};
use crate::report::gap::words::{self, verdict};
use crate::report::table::titled;
use std::path::Path;

/// Number of effects in the table: the probable ones, and at least three.
fn shown(d: &Diagnosis) -> usize {
    d.effects
        .iter()
        .take_while(|e| e.probability >= 0.01)
        .count()
        .clamp(3, 6)
}

/// The answer; `saved` is the file of the model.
pub fn summary(d: &Diagnosis, saved: Option<&Path>) -> String {
    let row = |e: &EffectEntry| {
        let [low, high] = e.closed_ci95.map(|share| share * 100.0);
        [
            e.name.to_owned(),
            e.stage.to_owned(),
            format!("{:.2}", e.probability),
            format!("{:.2}°", e.gap_before_deg),
            format!("{:.2}°", e.gap_after_deg),
            format!("{:.0} %", e.closed * 100.0),
            format!("{low:.0} to {high:.0} %"),
        ]
    };
    let header = "effect|stage|prob.|before|after|closed|95 %";
    let table = titled(header, 2..7, d.effects.iter().take(shown(d)).map(row));
    let mut out = vec![
        words::opening(d),
        verdict(&d.verdict),
        words::headline(d),
        words::place(d),
    ];
    let named = d
        .effects
        .iter()
        .filter(|e| d.verdict.names.contains(&e.name));
    for e in named {
        let values: Vec<String> = e.params.iter().map(words::value).collect();
        out.push(format!("{}: {}", words::plain(e.name), values.join("; ")));
    }
    out.extend(words::limits(d));
    if let several @ [_, _, ..] = d.logs.as_slice() {
        let row = |l: &LogEntry| {
            let [before, after] = [l.recalibrated_deg, l.explained_deg].map(|x| format!("{x:.2}°"));
            [l.file.clone(), before, after]
        };
        let rows = several.iter().map(row);
        out.push(titled("log|recalibrated|explained", 1..3, rows).to_string());
    }
    out.push(table.to_string());
    let next = |advice: &String| match saved {
        Some(path) => {
            let model = path.display().to_string();
            format!("next: {}", advice.replace("model.toml", &model))
        }
        None if advice.contains("gap check") => {
            format!("next: {advice} `--save model.toml` writes the model.")
        }
        None => format!("next: {advice}"),
    };
    out.extend(words::next(d).iter().map(next));
    out.join("\n")
}
