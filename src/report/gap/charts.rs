//! Drawings that the pages of a tip and of a mapped rig share. Each has a caption.

use crate::report::bars::{self, Bar};
use crate::report::{Axis, Chart, Ink, Series, Stroke};
use std::collections::BTreeMap;

/// Stretches of a residual.
const STRETCHES: usize = 80;
/// Most points of a shown trace.
const POINTS: usize = 2000;

/// A measured signal with the predictions of both models; NaN where they were not scored.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Label of the signal.
    pub label: String,
    /// Time since the log began, measured, recalibrated model, with effects.
    pub points: Vec<[f64; 4]>,
}

/// An effect in the ranking.
pub struct Ranked {
    /// Name as it is shown.
    pub name: String,
    /// Probability that it is present.
    pub probability: f64,
    /// Part of the gap that it closes, and its 95 % interval.
    pub closed: (f64, [f64; 2]),
    /// The verdict speaks of it.
    pub strong: bool,
}

/// RMS of the values in each group of a key.
pub fn rms<K: Ord>(of: impl Iterator<Item = (K, f64)>) -> impl Iterator<Item = (K, f64)> {
    let mut sums: BTreeMap<K, (f64, f64)> = BTreeMap::new();
    for (key, value) in of {
        let sum = sums.entry(key).or_default();
        *sum = (sum.0 + value.powi(2), sum.1 + 1.0);
    }
    sums.into_iter().map(|(k, (sum, n))| (k, (sum / n).sqrt()))
}

/// What both models leave over `x`, in equal stretches of it; `left` has x, recalibrated model, with effects. What is not finite was not
/// scored.
pub fn residuals(
    title: &str,
    x: &str,
    unit: &str,
    left: impl Iterator<Item = [f64; 3]>,
) -> (String, String) {
    let is_scored = |s: &[f64; 3]| s.iter().all(|x| x.is_finite());
    let left: Vec<[f64; 3]> = left.filter(is_scored).collect();
    let low = left.iter().map(|s| s[0]).fold(f64::INFINITY, f64::min);
    let high = left.iter().map(|s| s[0]).fold(low, f64::max);
    let (n, end) = (STRETCHES, (high - low).max(1e-9));
    let stretch = |at: f64| (((at - low) / end * n as f64) as usize).min(n - 1);
    let middle = |k: usize| low + (k as f64 + 0.5) * end / n as f64;
    let over = |i: usize| -> Vec<(f64, f64)> {
        let all = rms(left.iter().map(|s| (stretch(s[0]), s[i])));
        all.map(|(k, rms)| (middle(k), rms)).collect()
    };
    let (was, is) = (over(1), over(2));
    let end = was.last().map_or(1.0, |p| p.0);
    let largest = was.iter().chain(&is).map(|p| p.1).fold(0.0, f64::max);
    let x = Axis::new(x, low, end, 6);
    let y = Axis::new(&format!("residual / {unit}"), 0.0, 1.05 * largest, 5);
    let was = Series::line("recalibrated", Ink::RED, Stroke::Solid, was);
    let is = Series::line("with effects", Ink::BLUE, Stroke::Dashed, is);
    let chart = Chart::new(title, x, y, vec![was, is]).svg();
    (chart, format!("RMS in {STRETCHES} equal stretches."))
}

/// A signal, its points as in [`Trace`], in the window of this length in which the recalibrated model errs most.
pub fn trace(label: &str, points: &[[f64; 4]], window: f64, x: &str, y: &str) -> Option<Chart> {
    let error = |p: &[f64; 4]| (p[1] - p[2]).powi(2);
    let (first, last) = (points.first()?[0], points.last()?[0]);
    let starts = (0..).map(|k| first + f64::from(k) * window / 5.0);
    let starts = starts.take_while(|from| *from == first || from + window <= last);
    let within = |from: f64| {
        let shown = from..from + window;
        points.iter().filter(move |p| shown.contains(&p[0]))
    };
    let sum = |from: f64| -> f64 { within(from).filter(|p| p[2].is_finite()).map(error).sum() };
    let from = starts.max_by(|a, b| sum(*a).total_cmp(&sum(*b)))?;
    let every = within(from).count() / POINTS + 1;
    let shown = || within(from).step_by(every);
    let column = |i: usize| shown().map(|p| (p[0], p[i])).collect();
    let x = Axis::new(x, from, from + window, 5);
    let y = Axis::around(y, shown().flat_map(|p| p[1..].to_vec()), 5);
    let series = vec![
        Series::line("measured", Ink::GREY, Stroke::Solid, column(1)),
        Series::line("recalibrated", Ink::RED, Stroke::Dotted, column(2)),
        Series::line("with effects", Ink::BLUE, Stroke::Dashed, column(3)),
    ];
    Some(Chart::new(label, x, y, series))
}

/// How probable effects are, and what each closes.
pub fn ranking(effects: &[Ranked]) -> [(String, String); 2] {
    let bars = |share: fn(&Ranked) -> (f64, Option<[f64; 2]>)| -> Vec<Bar> {
        let one = |e: &Ranked| Bar {
            name: e.name.clone(),
            share: share(e).0,
            interval: share(e).1,
            strong: e.strong,
        };
        effects.iter().map(one).collect()
    };
    let chance = bars(|e| (e.probability, None));
    let closed = bars(|e| (e.closed.0, Some(e.closed.1)));
    let chance = bars::svg("Probability / %", Ink::GREEN, &chance);
    let closed = bars::svg("Part of the gap closed / %", Ink::BLUE, &closed);
    let present = "Probability that the effect is present; the verdict in full colour.";
    let alone = "Closed by the effect alone or, within a set, when added last; whiskers 95 %.";
    [(chance, present.to_owned()), (closed, alone.to_owned())]
}
