//! A diagnosis as one page: verdict in words, location of the gap in bend and time, measured and predicted signals,
//! ranking of the effects, limits of the verdict, and next steps.

pub mod evidence;
pub mod words;

use crate::diagnosis::decide::VerdictKind;
use crate::diagnosis::document::{Diagnosis, EffectEntry, ParamValue};
use crate::report::bars::{self, Bar};
use crate::report::chart::{Axis, Chart, Series, Stroke};
use crate::report::gap::evidence::{Evidence, Trace};
use crate::report::page::Page;
use crate::report::polar::Polar;
use crate::report::svg::Ink;

/// Effects in the ranking.
const RANKED: usize = 10;
/// Stretches of the residual over time.
const STRETCHES: usize = 80;
/// Length of a shown trace, s.
const TRACE_S: f64 = 25.0;

/// The page; `source` names the log.
#[must_use]
pub fn page(source: &str, d: &Diagnosis, evidence: &Evidence) -> String {
    let mut page = Page::new(&format!("Gap diagnosis: {source}"));
    page.text(&words::headline(d));
    page.text(&words::place(d));
    for limit in words::limits(d) {
        page.text(&limit);
    }
    page.table(&["gap, RMS over all sensors", "degrees"], &figures(d));
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
    page.table(&["effect", "stage", "probability", "gap before", "after", "closed", "95 %"], &rows(d));
    let values = parameters(d);
    if !values.is_empty() {
        page.heading("How much");
        page.table(&["parameter", "of", "channel", "value", "95 %", "unit"], &values);
    }
    page.heading("By sensor");
    page.table(&["sensor", "recalibrated", "with effects", "unit"], &sensors(d));
    page.html()
}

fn figures(d: &Diagnosis) -> Vec<[String; 2]> {
    let g = &d.gap;
    let row = |name: &str, deg: f64| [name.to_owned(), format!("{deg:.2}")];
    vec![
        row("as configured", g.as_configured_deg),
        row("recalibrated", g.recalibrated_deg),
        row("with the verdict's effects", g.explained_deg),
        row("noise", g.noise_floor_deg),
    ]
}

/// Two maps with one scale, and the residual over time.
fn places(e: &Evidence) -> Vec<(String, String)> {
    let (before, after) = (e.cells(|s| s.before_deg), e.cells(|s| s.after_deg));
    let high = before.iter().chain(&after).map(|c| c.value).fold(0.1, f64::max);
    let map = |title: &str, cells| Polar { title: title.to_owned(), label: "residual / °".to_owned(), high, cells }.svg();
    let over = |pick: fn(&evidence::Spot) -> f64| e.over_time(STRETCHES, pick);
    let (was, is) = (over(|s| s.before_deg), over(|s| s.after_deg));
    let end = was.last().map_or(1.0, |p| p.0);
    let time = Chart {
        title: "Residual over time".to_owned(),
        x: Axis::new("time / s", 0.0, end, 6),
        y: Axis::new("residual / °", 0.0, 1.05 * was.iter().chain(&is).map(|p| p.1).fold(0.2, f64::max), 5),
        series: vec![
            Series::line("recalibrated", Ink::RED, Stroke::Solid, was),
            Series::line("with effects", Ink::BLUE, Stroke::Dashed, is),
        ],
    };
    let angle = "Bend outwards, direction around; both maps share one scale.";
    vec![
        (map("Recalibrated model", before), format!("{angle} Cells without a colour were not visited.")),
        (map("With the verdict's effects", after), angle.to_owned()),
        (time.svg(), format!("RMS in {STRETCHES} stretches of the log.")),
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
    e.traces
        .iter()
        .take(4)
        .filter_map(|t| trace(t).map(|c| (c.svg(), format!("The {TRACE_S:.0} s with the largest error of the recalibrated model."))))
        .collect()
}

fn trace(t: &Trace) -> Option<Chart> {
    let error = |p: &[f64; 4]| if p[2].is_finite() { (p[1] - p[2]).powi(2) } else { 0.0 };
    let last = t.points.last()?[0];
    let windows = (0..).map(|k| f64::from(k) * TRACE_S / 5.0).take_while(|from| *from == 0.0 || from + TRACE_S <= last);
    let sum = |from: f64| t.points.iter().filter(|p| (from..from + TRACE_S).contains(&p[0])).map(error).sum::<f64>();
    let from = windows.max_by(|a, b| sum(*a).total_cmp(&sum(*b)))?;
    let shown: Vec<&[f64; 4]> = t.points.iter().filter(|p| (from..from + TRACE_S).contains(&p[0])).collect();
    let column = |i: usize| shown.iter().map(|p| (p[0], p[i])).collect::<Vec<_>>();
    Some(Chart {
        title: t.label.clone(),
        x: Axis::new("time / s", from, from + TRACE_S, 5),
        y: Axis::around("angle / °", shown.iter().flat_map(|p| p[1..].to_vec()), &[], 5),
        series: vec![
            Series::line("measured", Ink::GREY, Stroke::Solid, column(1)),
            Series::line("recalibrated", Ink::RED, Stroke::Dotted, column(2)),
            Series::line("with effects", Ink::BLUE, Stroke::Dashed, column(3)),
        ],
    })
}

fn ranking(d: &Diagnosis) -> Vec<(String, String)> {
    let named = |name: &str| d.verdict.names.contains(&name) || d.verdict.equivalent.iter().any(|g| g.contains(&name));
    let bars = |share: fn(&EffectEntry) -> (f64, Option<[f64; 2]>)| -> Vec<Bar> {
        let one = |e: &EffectEntry| {
            let (share, interval) = share(e);
            Bar { name: words::plain(e.name), share, interval, strong: named(e.name) }
        };
        d.effects.iter().take(RANKED).map(one).collect()
    };
    let stages: Vec<Bar> = d
        .location
        .stages
        .iter()
        .enumerate()
        .map(|(k, s)| Bar {
            name: s.name.to_owned(),
            share: s.share,
            interval: None,
            strong: k == 0 && d.verdict.kind != VerdictKind::None,
        })
        .collect();
    let chance = bars::svg("Probability / %", Ink::GREEN, &bars(|e| (e.probability, None)));
    let closed = bars::svg("Part of the gap closed / %", Ink::BLUE, &bars(|e| (e.closed, Some(e.closed_ci95))));
    vec![
        (bars::svg("Share of the gap by stage / %", Ink::PURPLE, &stages), merged(d)),
        (chance, "Probability that the effect is present; the verdict in full colour.".to_owned()),
        (closed, "Closed by the effect alone or, within a set, when added last; whiskers 95 %.".to_owned()),
    ]
}

fn rows(d: &Diagnosis) -> Vec<[String; 7]> {
    d.effects
        .iter()
        .take(RANKED)
        .map(|e| {
            [
                words::plain(e.name),
                e.stage.to_owned(),
                format!("{:.2}", e.probability),
                format!("{:.2}°", e.gap_before_deg),
                format!("{:.2}°", e.gap_after_deg),
                format!("{:.0} %", 100.0 * e.closed),
                format!("{:.0} to {:.0} %", 100.0 * e.closed_ci95[0], 100.0 * e.closed_ci95[1]),
            ]
        })
        .collect()
}

fn parameters(d: &Diagnosis) -> Vec<[String; 6]> {
    let chosen = d.effects.iter().filter(|e| d.verdict.names.contains(&e.name));
    let one = |e: &EffectEntry, p: &ParamValue| {
        let channel = if p.channel == 0 { "–".to_owned() } else { p.channel.to_string() };
        let range = format!("{} to {}", words::short(p.ci95[0]), words::short(p.ci95[1]));
        [
            words::plain(p.name),
            words::plain(e.name),
            channel,
            words::short(p.value),
            range,
            if p.unit.is_empty() { "–" } else { p.unit }.to_owned(),
        ]
    };
    chosen.flat_map(|e| e.params.iter().map(move |p| one(e, p))).collect()
}

fn sensors(d: &Diagnosis) -> Vec<[String; 4]> {
    let kinds = d.location.kinds.iter();
    kinds
        .map(|k| [k.name.to_owned(), format!("{:.2}", k.rmse_deg), format!("{:.2}", k.explained_deg), words::unit_of(k.name).to_owned()])
        .collect()
}
