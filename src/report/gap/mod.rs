//! A diagnosis as an answer on the terminal, and as one page: verdict in words, location of the gap in bend and time, measured and
//! predicted signals, ranking of the effects, limits of the verdict, and next steps.

pub mod charts;
pub mod compare;
pub mod evidence;
pub mod map;
pub mod schedule;
pub mod words;

use crate::diagnosis::tip::{Diagnosis, EffectEntry, LogEntry, QuantityShare, StageShare};
use crate::diagnosis::verdict::VerdictKind;
use crate::report::bars::{self, Bar};
use crate::report::gap::charts::{Ranked, Trace};
use crate::report::gap::evidence::{Evidence, Spot};
use crate::report::{Ink, Page, polar, table};
use std::path::Path;

/// Effects in the ranking.
const RANKED: usize = 10;
/// Length of a shown trace, s.
const TRACE_S: f64 = 25.0;

/// An effect as the tables show it.
fn effect_row(name: String, e: &EffectEntry) -> [String; 7] {
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
    let row = |e: &EffectEntry| effect_row(e.name.to_owned(), e);
    let header = "effect|stage|prob.|before|after|closed|95 %";
    // the probable ones, and at least three
    let probable = d.effects.iter().take_while(|e| e.probability >= 0.01);
    let shown = d.effects.iter().take(probable.count().clamp(3, 6));
    let ranking = table(header, 2..7, shown.map(row));
    let mut out = vec![
        words::opening(d),
        words::verdict(&d.verdict),
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

/// The page; `source` names the log, and `made` states what it was made from and with, by name.
pub fn page(source: &str, d: &Diagnosis, evidence: &Evidence, made: &[[String; 2]]) -> String {
    let mut page = Page::new(&format!("Gap diagnosis: {source}"));
    page.text(&words::headline(d));
    page.text(&words::place(d));
    for limit in words::limits(d) {
        page.text(&limit);
    }
    let row = |name: &str, deg: f64| [name.to_owned(), format!("{deg:.2}")];
    let figures = [
        row("as configured", d.gap.as_configured_deg),
        row("recalibrated", d.gap.recalibrated_deg),
        row("with the verdict's effects", d.gap.explained_deg),
        row("noise", d.gap.noise_floor_deg),
    ];
    page.table("gap, RMS over all sensors|degrees", figures);
    page.quiet("All numbers except the first are scored on parts of the log that the fit has not seen. Recalibration identifies the gains of the nominal model again on this log; what it closes is not credited to an effect.");
    page.heading("Next");
    for step in words::next(d) {
        page.text(&step);
    }
    page.heading("Where");
    page.charts(places(evidence));
    page.heading("Measured and predicted signals");
    page.charts(traces(evidence));
    page.heading("Which");
    page.charts(ranking(d));
    let row = |e: &EffectEntry| effect_row(words::plain(e.name), e);
    let header = "effect|stage|probability|gap before|after|closed|95 %";
    page.table(header, d.effects.iter().take(RANKED).map(row));
    let values: Vec<_> = words::named(d).flat_map(parameters).collect();
    if !values.is_empty() {
        page.heading("How much");
        page.table("parameter|of|channel|value|95 %|unit", values);
    }
    page.heading("By sensor");
    let sensor = |k: &QuantityShare| {
        let [before, after] = [k.rmse_deg, k.explained_deg].map(|x| format!("{x:.2}"));
        let unit = words::unit_of(k.name).to_owned();
        [k.name.to_owned(), before, after, unit]
    };
    let sensors = d.location.kinds.iter().map(sensor);
    page.table("sensor|recalibrated|with effects|unit", sensors);
    page.made_from(made, "docs/gap.md");
    page.html()
}

/// Two maps with one scale, and the residual over time.
fn places(e: &Evidence) -> Vec<(String, String)> {
    let (before, after) = (e.cells(|s| s.before_deg), e.cells(|s| s.after_deg));
    let all = before.iter().chain(&after).map(|c| c.value);
    let high = all.fold(0.1, f64::max);
    let map = |title, cells: &[_]| polar::svg(title, "residual / °", high, cells);
    let left = |s: &Spot| [s.t_s, s.before_deg, s.after_deg];
    let left = e.spots.iter().map(left);
    let time = charts::residuals("Residual over time", "time / s", "°", left);
    let angle = "Bend outwards, direction around; both maps share one scale.";
    let unvisited = format!("{angle} Cells without a colour were not visited.");
    vec![
        (map("Recalibrated model", &before), unvisited),
        (map("With the verdict's effects", &after), angle.to_owned()),
        time,
    ]
}

fn merged(d: &Diagnosis) -> String {
    let groups: Vec<String> = d.location.merged.iter().map(|m| m.join(" and ")).collect();
    if groups.is_empty() {
        "By the probabilities of the effects of the stage.".to_owned()
    } else {
        format!("This log cannot separate: {}.", groups.join("; "))
    }
}

/// The signals with the largest closed gap, each in the window in which the gap is largest.
fn traces(e: &Evidence) -> Vec<(String, String)> {
    let caption = format!("The {TRACE_S:.0} s with the largest error of the recalibrated model.");
    let draw = |t: &Trace| charts::trace(&t.label, &t.points, TRACE_S, "time / s", "angle / °");
    let charts = e.traces.iter().take(4).filter_map(draw);
    charts.map(|c| (c.svg(), caption.clone())).collect()
}

fn ranking(d: &Diagnosis) -> Vec<(String, String)> {
    let ranked = |e: &EffectEntry| Ranked {
        name: words::plain(e.name),
        probability: e.probability,
        closed: (e.closed, e.closed_ci95),
        strong: d.verdict.speaks_of(e.name),
    };
    let ranked: Vec<Ranked> = d.effects.iter().take(RANKED).map(ranked).collect();
    let is_gap = d.verdict.kind != VerdictKind::None;
    let bar = |(k, s): (usize, &StageShare)| Bar {
        name: s.name.to_owned(),
        share: s.share,
        interval: None,
        strong: k == 0 && is_gap,
    };
    let stages: Vec<Bar> = d.location.stages.iter().enumerate().map(bar).collect();
    let stages = bars::svg("Share of the gap by stage / %", Ink::PURPLE, &stages);
    let mut all = vec![(stages, merged(d))];
    all.extend(charts::ranking(&ranked));
    all
}

/// The parameters of an effect.
fn parameters(e: &EffectEntry) -> impl Iterator<Item = [String; 6]> {
    let or_dash = |text: &str| if text.is_empty() { "–" } else { text }.to_owned();
    e.params.iter().map(move |p| {
        let channel = Some(p.channel).filter(|n| *n != 0);
        let [low, high] = p.ci95.map(words::short);
        [
            words::plain(p.name),
            words::plain(e.name),
            channel.map_or("–".to_owned(), |n| n.to_string()),
            words::short(p.value),
            format!("{low} to {high}"),
            or_dash(p.unit),
        ]
    })
}
