//! An evaluation as charts, tables and a page: the paper's Figure 6 redrawn, with the closed loop beside it.
//!
//! Figure 6 shows measured against desired bend, mean over the directions ± 1 σ: (a) no compensation and extension, (b) no
//! compensation and extension with backlash, (c) the gains of each pass. The outward way is solid and the way back is
//! dashed, because backlash separates them.

use crate::experiment::arm::{ArmResult, Held};
use crate::experiment::evaluation::{Arm, ChannelFigures, Evaluation, Predicted};
use crate::experiment::schedule::{ANGLES_DEG, HOLD_S};
use crate::experiment::track::TrackResult;
use crate::report::chart::{Axis, Chart, Series, Stroke, sheet};
use crate::report::{Ink, Page, table};

/// Name of an arm for people, its colour, and its bend RMSE on the paper's prototype, degrees.
fn look(arm: Arm) -> (&'static str, Ink, Option<f64>) {
    match arm {
        Arm::None => ("no compensation", Ink::RED, Some(36.96)),
        Arm::Extension => ("extension", Ink::ORANGE, Some(8.04)),
        Arm::Backlash => ("extension + backlash", Ink::BLUE, Some(7.76)),
        Arm::Closed => ("closed loop", Ink::GREEN, None),
        Arm::Diagnosed => ("diagnosed", Ink::PURPLE, None),
    }
}

/// A figure of an arm as the tables show it.
type ArmFigure = fn(Arm, &ArmResult) -> String;

/// The figures of an arm, each with its name.
const ARM_FIGURES: [(&str, ArmFigure); 11] = [
    ("bend RMSE", |_, a| deg(a.bend_rmse_deg)),
    ("paper", |arm, _| look(arm).2.map_or("–".to_owned(), deg)),
    ("orientation RMSE", |_, a| deg(a.orientation_rmse_deg)),
    ("its floor", |_, a| deg(a.orientation_floor_deg)),
    ("estimation error", |_, a| deg(a.estimate_rmse_deg)),
    ("median to 1°", |_, a| settle(a.settle_s_median)),
    ("95 % to 1°", |_, a| settle(a.settle_s_p95)),
    ("never to 1°", |_, a| a.unsettled.to_string()),
    ("peak to peak", |_, a| deg(a.peak_to_peak_max_deg)),
    ("states", |_, a| a.states.to_string()),
    ("obstructed", |_, a| a.blocked.to_string()),
];

/// Degrees with two decimals.
pub fn deg(x: f64) -> String {
    format!("{x:.2}°")
}

/// The arms that ran.
fn arms(e: &Evaluation) -> impl Iterator<Item = (Arm, &ArmResult)> {
    let ran = |arm| Some((arm, e.arm(arm)?));
    Arm::ALL.into_iter().filter_map(ran)
}

/// A chart with the caption that a page shows below it.
type Figure = (Chart, &'static str);

const OVER_DIRECTIONS: &str = "Mean over twelve directions, ± 1 σ shaded; solid on the way out, dashed on the way back; dotted: ideal.";

/// The charts that this evaluation has data for.
fn figures(e: &Evaluation) -> Vec<Figure> {
    use Arm::{Backlash, Closed, Extension, None};
    let closed = e.arm(Closed);
    let both = "(b) Extension and backlash compensation";
    let all = [
        bends(e, "(a) Extension compensation", &[None, Extension]),
        bends(e, both, &[None, Backlash]),
        convergence(e),
        closed.and_then(|_| bends(e, "(d) Closed loop", &[Backlash, Closed])),
        closed.map(errors),
        settling(e),
    ];
    all.into_iter().flatten().collect()
}

/// All charts on one drawing.
pub fn svg(e: &Evaluation) -> String {
    let charts: Vec<Chart> = figures(e).into_iter().map(|f| f.0).collect();
    sheet("retroflex evaluate", &charts, 3)
}

/// Mean and standard deviation over the directions, at one desired angle, on the way out or back.
fn over_directions(
    held: &[Held],
    angle_deg: f64,
    outward: bool,
    f: impl Fn(&Held) -> f64,
) -> Option<(f64, f64)> {
    let there = |h: &&Held| h.bend_deg == angle_deg && h.outward == outward;
    let values: Vec<f64> = held.iter().filter(there).map(f).collect();
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (!values.is_empty()).then_some((mean, variance.sqrt()))
}

/// A band and a line for the way out, and for the way back.
fn out_and_back(arm: &ArmResult, name: &str, ink: Ink, f: impl Fn(&Held) -> f64) -> Vec<Series> {
    let out = format!("{name}, out");
    let mut series = Vec::new();
    let ways = [
        (true, Stroke::Solid, &*out),
        (false, Stroke::Dashed, "back"),
    ];
    for (outward, stroke, label) in ways {
        let at = |a: f64| over_directions(&arm.held, a, outward, &f).map(|(m, s)| (a, m, s));
        let points: Vec<_> = ANGLES_DEG.iter().filter_map(|&a| at(a)).collect();
        let band = points.iter().map(|&(a, m, s)| (a, m - s, m + s)).collect();
        let line = points.iter().map(|p| (p.0, p.1)).collect();
        series.push(Series::band(ink, band));
        series.push(Series::line(label, ink, stroke, line));
    }
    series
}

/// Desired bend of the held states.
fn desired() -> Axis {
    Axis::with_ticks("desired bend / °", 10.0, 80.0, &ANGLES_DEG)
}

fn bends(e: &Evaluation, heading: &str, arms: &[Arm]) -> Option<Figure> {
    let ideal = vec![(0.0, 0.0), (90.0, 90.0)];
    let mut series = vec![Series::line("", Ink::GREY, Stroke::Dotted, ideal)];
    for (arm, result) in self::arms(e).filter(|(arm, _)| arms.contains(arm)) {
        let ((name, ink, _), measured) = (look(arm), |h: &Held| h.bend_deg - h.bend_error_deg);
        series.extend(out_and_back(result, name, ink, measured));
    }
    let y = Axis::new("measured bend / °", 0.0, 90.0, 6);
    (series.len() > 1).then(|| (Chart::new(heading, desired(), y, series), OVER_DIRECTIONS))
}

fn convergence(e: &Evaluation) -> Option<Figure> {
    if e.history.len() < 2 {
        return None;
    }
    let strokes = [Stroke::Solid, Stroke::Dashed, Stroke::Dotted];
    let track = |i: usize, g: usize| -> Vec<(f64, f64)> {
        let passes = e.history.iter().enumerate();
        passes.map(|(n, pass)| (n as f64, pass[i][g])).collect()
    };
    let mut series = Vec::new();
    for (g, symbol, ink) in [(0, "k_ε", Ink::BLUE), (1, "k_λ / mm", Ink::PURPLE)] {
        for (i, stroke) in strokes.into_iter().enumerate() {
            let name = format!("{symbol} {}", i + 1);
            series.push(Series::line(&name, ink, stroke, track(i, g)));
            series.push(Series::dots(ink, track(i, g)));
        }
    }
    let values = e.history.iter().flatten().flatten().copied();
    let x = Axis::new("pass", 0.0, (e.history.len() - 1) as f64, e.history.len());
    let y = Axis::around("gain", values.chain([0.0]), 6);
    let chart = Chart::new("(c) Algorithm 1, pass by pass", x, y, series);
    Some((chart, "From zero; 120 measured states in each pass."))
}

/// The error of every held state in the closed loop.
fn errors(arm: &ArmResult) -> Figure {
    let mut series = out_and_back(arm, "mean ± σ", Ink::GREEN, |h| h.bend_error_deg);
    let beside = |h: &Held| h.bend_deg + if h.outward { -1.2 } else { 1.2 };
    let dots = arm.held.iter().map(|h| (beside(h), h.bend_error_deg));
    series.push(Series::dots(Ink::GREEN, dots.collect()));
    let errors = arm.held.iter().map(|h| h.bend_error_deg);
    let y = Axis::around("desired − measured bend / °", errors.chain([-0.5, 0.5]), 6);
    let title = "(e) Closed loop, error of every held state";
    let caption = "Dots: mean of each held state; left of its angle on the way out, right of it on the way back.";
    (Chart::new(title, desired(), y, series), caption)
}

/// Fraction of the states that have settled within 1° after a given time.
fn settling(e: &Evaluation) -> Option<Figure> {
    let mut series = Vec::new();
    for (arm, result) in arms(e) {
        let mut times: Vec<f64> = result.held.iter().filter_map(|h| h.settle_s).collect();
        times.sort_by(f64::total_cmp);
        let n = result.held.len().max(1) as f64;
        let mut steps = vec![(0.0, 0.0)];
        for (k, &t) in times.iter().enumerate() {
            steps.extend([(t, 100.0 * k as f64 / n), (t, 100.0 * (k + 1) as f64 / n)]);
        }
        steps.push((HOLD_S, 100.0 * times.len() as f64 / n));
        let (name, ink, _) = look(arm);
        series.push(Series::line(name, ink, Stroke::Solid, steps));
    }
    let x = Axis::new("time since the command / s", 0.0, HOLD_S, 6);
    let y = Axis::new("fraction of the 120 states / %", 0.0, 100.0, 5);
    let chart = Chart::new("(f) States settled within 1°", x, y, series);
    let caption = "A state has settled once its bend error stays below 1°; a curve that ends below 100 % has states that never do.";
    (!chart.series.is_empty()).then_some((chart, caption))
}

/// The page.
pub fn html(e: &Evaluation) -> String {
    let mut page = Page::new("retroflex evaluate");
    page.text(&format!(
        "Plant “{}”, seed {}. Twelve directions, 15 to 75° out and back: 120 held states of 1.5 s in each arm. The bend error is \
         desired minus true bend over the last 0.3 s of each state. The floor of the orientation error is what the twist of the \
         tip leaves to any controller, since no bellow actuates it.",
        e.plant, e.seed
    ));
    let names = ARM_FIGURES.map(|(name, _)| name).join("|");
    let row = |(arm, a): (Arm, &ArmResult)| {
        let figures = ARM_FIGURES.map(|(_, figure)| figure(arm, a));
        [vec![look(arm).0.to_owned()], figures.into()].concat()
    };
    page.table(&format!("arm|{names}"), arms(e).map(row));
    page.heading("The paper's Figure 6, redrawn, and the closed loop");
    let drawn = |(chart, caption): Figure| (chart.svg(), caption);
    page.charts(figures(e).into_iter().map(drawn));
    page.heading("Gains");
    page.text(&if e.iterations == 0 {
        "Taken from a calibration file.".to_owned()
    } else {
        let end = if e.converged { "converged to 2 %" } else { "did not converge to 2 %" };
        format!(
            "Algorithm 1 from zero {end} after {} passes of 120 states. Lag {:.0} ms, dead time {:.0} ms.",
            e.iterations,
            1e3 * e.lag_s,
            1e3 * e.delay_s
        )
    });
    let header = "channel|k_ε|± σ|k_λ / mm|± σ / mm|condition|residual / mm";
    page.table(header, gain_rows(e));
    page.quiet("For research. Not a medical device.");
    page.html()
}

/// A quantile of the settling time; that of a state that does not settle is only a lower bound.
pub fn settle(s: f64) -> String {
    if s < HOLD_S {
        format!("{s:.2} s")
    } else {
        format!("> {HOLD_S} s")
    }
}

fn gain_rows(e: &Evaluation) -> [Vec<String>; 3] {
    let row = |i: usize| {
        let found = e.identified.get(i);
        let or_dash = |f: fn(&ChannelFigures) -> String| found.map_or("–".to_owned(), f);
        vec![
            (i + 1).to_string(),
            format!("{:.3}", e.k_eps[i]),
            or_dash(|c| format!("{:.3}", c.k_eps_sigma)),
            format!("{:.3}", e.k_lambda_mm[i]),
            or_dash(|c| format!("{:.3}", c.k_lambda_sigma_mm)),
            or_dash(|c| format!("{:.1}", c.condition)),
            or_dash(|c| format!("{:.2}", c.residual_mm)),
        ]
    };
    [0, 1, 2].map(row)
}

/// The table of arms and the gains, for people.
pub fn summary(e: &Evaluation) -> String {
    let gains = |g: &[f64; 3]| g.map(|x| format!("{x:.2}")).join(", ");
    let origin = match (e.iterations, e.converged) {
        (0, _) => "from the calibration file".to_owned(),
        (n, true) => format!("Algorithm 1, {n} passes"),
        (n, false) => format!("Algorithm 1, NOT converged after {n} passes"),
    };
    // a figure a row, so that the table is narrow
    let names = arms(e).map(|(arm, _)| format!("|{}", arm.name()));
    let (names, n): (String, _) = (names.collect(), e.arms.len());
    let line = |(name, figure): (&str, ArmFigure)| {
        let cells = arms(e).map(|(arm, a)| figure(arm, a)).collect();
        [vec![name.to_owned()], cells].concat()
    };
    let mut tables = String::new();
    if n > 0 {
        tables = format!("{}\n", table(&names, 1..n + 1, ARM_FIGURES.map(line)));
    }
    tables.push('\n');
    if !e.foretold.is_empty() {
        let row = |f: &Predicted| {
            let figures = [f.machine_deg, f.twin_deg, f.nominal_deg].map(|x| format!("{x:.1}°"));
            [vec![f.name.clone()], figures.into()].concat()
        };
        let header = "bend RMSE, open loop|machine|its twin foretells|nominal model foretells";
        tables += &format!("{}\n", table(header, 1..4, e.foretold.iter().map(row)));
    }
    let path = e.track.as_ref().map_or(String::new(), |t| {
        format!(
            "path of {:.1} s: RMSE {:.2}°, 95 % {:.2}°, at most {:.2}°; delay {:.3} s, RMSE after it {:.2}°\n",
            t.duration_s, t.rmse_deg, t.p95_deg, t.max_deg, t.delay_s, t.rmse_delayed_deg
        )
    });
    let (k_eps, k_lambda) = (gains(&e.k_eps), gains(&e.k_lambda_mm));
    let (plant, seed) = (&e.plant, e.seed);
    format!(
        "plant {plant}, seed {seed}\n\n{tables}{path}k_ε = {k_eps}   k_λ = {k_lambda} mm   ({origin})\n"
    )
}

/// What is to be said of a path that the pistons cannot follow as it is.
pub fn too_fast(t: &TrackResult) -> Option<String> {
    let demand = t.demand;
    let done = if t.live {
        "a live path is not slowed down, so the tip falls behind"
    } else {
        "it was driven that much slower"
    };
    (demand > 1.0).then(|| {
        format!("the path asks {demand:.2} times the speed that the pistons can follow; {done}")
    })
}
