//! A diagnosis in words and tables.

use crate::diagnosis::tip::{Diagnosis, EffectEntry, LogEntry};
use crate::report::gap::words::{self, verdict};
use crate::report::table::table;
use std::path::Path;

/// An effect as the tables show it.
pub(super) fn row(name: String, e: &EffectEntry) -> [String; 7] {
    let [low, high] = e.closed_ci95.map(|share| share * 100.0);
    [
        name,
        e.stage.to_owned(),
        format!("{:.2}", e.probability),
        format!("{:.2}°", e.gap_before_deg),
        format!("{:.2}°", e.gap_after_deg),
        format!("{:.0} %", e.closed * 100.0),
        format!("{low:.0} to {high:.0} %"),
    ]
}

/// The answer; `saved` is the file of the model.
pub fn summary(d: &Diagnosis, saved: Option<&Path>) -> String {
    let row = |e: &EffectEntry| row(e.name.to_owned(), e);
    let header = "effect|stage|prob.|before|after|closed|95 %";
    // the probable ones, and at least three
    let probable = d.effects.iter().take_while(|e| e.probability >= 0.01);
    let shown = d.effects.iter().take(probable.count().clamp(3, 6));
    let ranking = table(header, 2..7, shown.map(row));
    let mut out = vec![
        words::opening(d),
        verdict(&d.verdict),
        words::headline(d),
        words::place(d),
    ];
    for e in words::named(d) {
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
        out.push(table("log|recalibrated|explained", 1..3, rows).to_string());
    }
    out.push(ranking.to_string());
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
