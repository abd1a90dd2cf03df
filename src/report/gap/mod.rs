//! A diagnosis as one page: verdict in words, location of the gap in bend and time, measured and predicted signals,
//! ranking of the effects, limits of the verdict, and next steps.

pub mod answer;
pub mod compare;
pub mod evidence;
pub mod map;
pub mod schedule;
pub mod words;

use crate::diagnosis::tip::{Diagnosis, EffectEntry, QuantityShare};
use crate::diagnosis::verdict::VerdictKind;
use crate::report::bars::{self, Bar};
use crate::report::gap::evidence::{Evidence, Trace};
use crate::report::{Axis, Chart, Ink, Page, Series, Stroke, polar};

/// Effects in the ranking.
const RANKED: usize = 10;
/// Stretches of the residual over time.
const STRETCHES: usize = 80;
/// Length of a shown trace, s.
const TRACE_S: f64 = 25.0;

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
    page.table("gap, RMS over all sensors|degrees", &figures);
    page.quiet("All numbers except the first are scored on parts of the log that the fit has not seen. Recalibration identifies the gains of the nominal model again on this log; what it closes is not credited to an effect.");
    page.heading("Next");
    for step in words::next(d) {
        page.text(&step);
    }
    page.heading("Where");
    page.charts(&places(evidence));
    page.heading("Measured and predicted signals");
    page.charts(&traces(evidence));
    page.heading("Which");
    page.charts(&ranking(d));
    let row = |e: &EffectEntry| answer::row(words::plain(e.name), e);
    let rows: Vec<_> = d.effects.iter().take(RANKED).map(row).collect();
    let header = "effect|stage|probability|gap before|after|closed|95 %";
    page.table(header, &rows);
    let values: Vec<_> = words::named(d).flat_map(parameters).collect();
    if !values.is_empty() {
        page.heading("How much");
        page.table("parameter|of|channel|value|95 %|unit", &values);
    }
    page.heading("By sensor");
    let sensor = |k: &QuantityShare| {
        let [before, after] = [k.rmse_deg, k.explained_deg].map(|x| format!("{x:.2}"));
        let unit = words::unit_of(k.name).to_owned();
        [k.name.to_owned(), before, after, unit]
    };
    let sensors: Vec<_> = d.location.kinds.iter().map(sensor).collect();
    page.table("sensor|recalibrated|with effects|unit", &sensors);
    page.heading("Made from");
    page.table("|", made);
    page.quiet("docs/gap.md of the program explains how to read this page.");
    page.html()
}

/// Two maps with one scale, and the residual over time.
fn places(e: &Evidence) -> Vec<(String, String)> {
    let (before, after) = (e.cells(|s| s.before_deg), e.cells(|s| s.after_deg));
    let all = before.iter().chain(&after).map(|c| c.value);
    let high = all.fold(0.1, f64::max);
    let map = |title, cells: &[_]| polar::svg(title, "residual / °", high, cells);
    let over = |pick: fn(&evidence::Spot) -> f64| e.over_time(STRETCHES, pick);
    let (was, is) = (over(|s| s.before_deg), over(|s| s.after_deg));
    let end = was.last().map_or(1.0, |p| p.0);
    let largest = was.iter().chain(&is).map(|p| p.1).fold(0.2, f64::max);
    let x = Axis::new("time / s", 0.0, end, 6);
    let y = Axis::new("residual / °", 0.0, 1.05 * largest, 5);
    let was = Series::line("recalibrated", Ink::RED, Stroke::Solid, was);
    let is = Series::line("with effects", Ink::BLUE, Stroke::Dashed, is);
    let time = Chart::new("Residual over time", x, y, vec![was, is]);
    let angle = "Bend outwards, direction around; both maps share one scale.";
    let unvisited = format!("{angle} Cells without a colour were not visited.");
    let stretches = format!("RMS in {STRETCHES} stretches of the log.");
    vec![
        (map("Recalibrated model", &before), unvisited),
        (map("With the verdict's effects", &after), angle.to_owned()),
        (time.svg(), stretches),
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
    let charts = e.traces.iter().take(4).filter_map(trace);
    charts.map(|c| (c.svg(), caption.clone())).collect()
}

fn trace(t: &Trace) -> Option<Chart> {
    let error = |p: &[f64; 4]| (p[1] - p[2]).powi(2);
    let last = t.points.last()?[0];
    let starts = (0..).map(|k| f64::from(k) * TRACE_S / 5.0);
    let starts = starts.take_while(|from| *from == 0.0 || from + TRACE_S <= last);
    let within = |from: f64| {
        let window = from..from + TRACE_S;
        t.points.iter().filter(move |p| window.contains(&p[0]))
    };
    let sum = |from: f64| -> f64 { within(from).filter(|p| p[2].is_finite()).map(error).sum() };
    let from = starts.max_by(|a, b| sum(*a).total_cmp(&sum(*b)))?;
    let column = |i: usize| within(from).map(|p| (p[0], p[i])).collect();
    let x = Axis::new("time / s", from, from + TRACE_S, 5);
    let angles = within(from).flat_map(|p| p[1..].to_vec());
    let y = Axis::around("angle / °", angles, 5);
    let series = vec![
        Series::line("measured", Ink::GREY, Stroke::Solid, column(1)),
        Series::line("recalibrated", Ink::RED, Stroke::Dotted, column(2)),
        Series::line("with effects", Ink::BLUE, Stroke::Dashed, column(3)),
    ];
    Some(Chart::new(&t.label, x, y, series))
}

fn ranking(d: &Diagnosis) -> Vec<(String, String)> {
    let groups = d.verdict.equivalent.iter().chain([&d.verdict.names]);
    let named: Vec<_> = groups.flatten().collect();
    let bar = |name, share, interval, strong| Bar {
        name,
        share,
        interval,
        strong,
    };
    let bars = |share: fn(&EffectEntry) -> (f64, Option<[f64; 2]>)| -> Vec<Bar> {
        let one = |e: &EffectEntry| {
            let ((share, interval), strong) = (share(e), named.contains(&&e.name));
            bar(words::plain(e.name), share, interval, strong)
        };
        d.effects.iter().take(RANKED).map(one).collect()
    };
    let is_gap = d.verdict.kind != VerdictKind::None;
    let stages = d.location.stages.iter().enumerate();
    let stages = stages.map(|(k, s)| bar(s.name.to_owned(), s.share, None, k == 0 && is_gap));
    let stages: Vec<Bar> = stages.collect();
    let chance = bars(|e| (e.probability, None));
    let closed = bars(|e| (e.closed, Some(e.closed_ci95)));
    let stages = bars::svg("Share of the gap by stage / %", Ink::PURPLE, &stages);
    let chance = bars::svg("Probability / %", Ink::GREEN, &chance);
    let closed = bars::svg("Part of the gap closed / %", Ink::BLUE, &closed);
    let present = "Probability that the effect is present; the verdict in full colour.";
    let alone = "Closed by the effect alone or, within a set, when added last; whiskers 95 %.";
    vec![
        (stages, merged(d)),
        (chance, present.to_owned()),
        (closed, alone.to_owned()),
    ]
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
