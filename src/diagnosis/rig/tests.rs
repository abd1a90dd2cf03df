//! Random rigs of known cause: what is found does not depend on zeros and units, and parameters are found where they are.

use crate::diagnosis::rig::operators::catalogue;
use crate::diagnosis::rig::table::ROWS_MAX;
use crate::diagnosis::rig::{DRIVEN, Document, MapFile, Nominal, RigProblem, Signals};
use crate::diagnosis::{Problem, Scored, diagnose, search, statements};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

const MAP: &str = "input = \"u\"\noutput = \"y\"\ntime = \"t\"\n";
/// Steps of the simulation per row.
const FINE: usize = 20;

/// A rig with one cause.
struct Drawn {
    signals: Signals,
    /// Parameter of the cause in the unit of its operator.
    truth: f64,
    /// Noise of a row, 1 σ.
    noise: f64,
}

/// Diagnoses logs of one rig.
pub fn document(map: &MapFile, logs: &[Signals]) -> Document {
    let problem = RigProblem::new(map, logs, 1);
    problem.map_or_else(
        || Document::empty(map),
        |problem| diagnose(&problem).document,
    )
}

/// Every feature has a weight, and every weight a feature.
#[test]
fn the_weights_are_those_of_the_features() {
    let drawn = draw("creep", 1);
    let (map, logs) = (map(), [drawn.signals]);
    let problem = RigProblem::new(&map, &logs, 1).unwrap();
    let said = statements(&problem, &search(&problem));
    let names = said.iter().flat_map(|s| &s.features).map(|(name, _)| name);
    let all = [Nominal::Still, Nominal::Line, Nominal::Resonance].map(|n| catalogue(n, true));
    let forms = all
        .iter()
        .flatten()
        .map(|operator| format!("form_{}", operator.name));
    let known: BTreeSet<String> = names.cloned().chain(forms).collect();
    let weights: BTreeSet<String> = RigProblem::head().weight.keys().cloned().collect();
    assert_eq!(known, weights);
}

fn map() -> MapFile {
    toml::from_str(MAP).unwrap()
}

fn range(x: &[f64]) -> [f64; 2] {
    x.iter()
        .fold([f64::MAX, f64::MIN], |[l, h], &x| [l.min(x), h.max(x)])
}

/// Draws a rig of a cause.
fn draw(cause: &str, seed: u64) -> Drawn {
    let mut rng = StdRng::seed_from_u64(seed * 7919 + cause.len() as u64);
    let (rows, periods) = (
        [1500, 2500, 4000][rng.random_range(0..3)],
        rng.random_range(8.0..15.0),
    );
    drive(cause, &mut rng, rows, periods)
}

/// Draws units, input, size and noise. The law runs in steps that are much finer than the rows.
fn drive(cause: &str, rng: &mut StdRng, rows: usize, periods: f64) -> Drawn {
    let step_s = 10f64.powf(rng.random_range(-3.0..1.0));
    let (unit, span) = (
        10f64.powf(rng.random_range(-3.0..3.0)),
        rows as f64 * step_s,
    );
    let slow_s = span / periods;
    let waves =
        [1.0, 1.7, 2.9, 0.43].map(|k| (k, rng.random_range(0.4..1.0), rng.random_range(0.0..TAU)));
    let input = |t: f64| {
        let wave = |(k, a, p): (f64, f64, f64)| a * (TAU * k * t / slow_s + p).sin();
        unit * waves.into_iter().map(wave).sum::<f64>()
    };
    let fine = |k: usize| input(k as f64 * step_s / FINE as f64);
    let [low, high] = range(&(0..rows * FINE).map(fine).collect::<Vec<_>>());
    let (all, middle) = (high - low, (high + low) / 2.0);
    let size = rng.random_range(0.06..0.2);
    let truth = match cause {
        "delay" | "lag" => 0.3 * size * slow_s,
        "creep" => (0.2 + size / 2.0) * slow_s,
        "leak" => 4.0 * size * slow_s,
        "rate_limit" => rng.random_range(1.5..2.5) / slow_s,
        "saturation" => 1.0 - 4.0 * size,
        "asymmetry" => 0.5 + size,
        "periodic_position" => all * rng.random_range(0.1..0.15),
        "periodic_time" => span / rng.random_range(20.0..90.0),
        _ => size,
    };
    let (mut state, mut slower) = (input(0.0), input(0.0));
    let (dt, mut law) = (step_s / FINE as f64, vec![]);
    for k in 0..(rows - 1) * FINE + 1 {
        let (u, t) = (fine(k), k as f64 * dt);
        let wave = |turns: f64| 0.3 * size * all * (TAU * turns + 1.0).sin();
        let follow = |s: f64, tau: f64| s + (u - s) * (1.0 - (-dt / tau).exp());
        state = match cause {
            "play" => state.max(u - truth * all).min(u + truth * all),
            "rate_limit" => state + (u - state).clamp(-truth * all * dt, truth * all * dt),
            _ => follow(state, truth),
        };
        slower = follow(slower, 12.0 * truth);
        if k.is_multiple_of(FINE) {
            law.push(match cause {
                "play" | "rate_limit" | "lag" => state,
                "creep" => u + 0.4 * state + 0.3 * slower,
                "leak" => u - 0.5 * state,
                "delay" => input((t - truth).max(0.0)),
                "dead_band" => u - u.clamp(-truth * all, truth * all),
                "saturation" => middle + (u - middle).clamp(-truth * all / 2.0, truth * all / 2.0),
                "asymmetry" => u + 0.3 * (u - low - truth * all).abs(),
                "periodic_position" => u + wave(u / truth),
                "periodic_time" => u + wave(t / truth),
                "cubic" => u + 3.0 * size * u * (u / all).powi(2),
                "drift" => u + size * all * t / span,
                _ => u,
            });
        }
    }
    let gain = 10f64.powf(rng.random_range(-2.0..2.0)) * [-1.0, 1.0][rng.random_range(0..2)];
    let noise = gain.abs() * all * 10f64.powf(rng.random_range(-3.0..-2.0));
    // a corner is counted from the least output
    let truth = match cause {
        "asymmetry" if gain < 0.0 => 1.0 - truth,
        _ => truth,
    };
    let y = |x: &f64| gain * (x + 0.3 * all) + noise * rng.sample::<f64, _>(StandardNormal);
    let u: Vec<f64> = (0..rows).map(|k| fine(k * FINE)).collect();
    let signals = Signals {
        file: String::new(),
        output: law.iter().map(y).collect(),
        motion: Some(u.clone()),
        inputs: vec![u],
        t: (0..rows).map(|k| k as f64 * step_s).collect(),
        logged: rows,
        clocked: true,
    };
    Drawn {
        signals,
        truth,
        noise,
    }
}

#[test]
fn the_zeros_of_input_and_output_do_not_count() {
    // a cubic is left out: a dead band, which lies about an input of zero, imitates it there alone
    let causes = ["none", "none", "delay", "lag", "saturation", "drift"];
    for (seed, cause) in (0..).zip(causes) {
        let drawn = draw(cause, seed).signals;
        let moved = |x: &[f64], by: f64| -> Vec<f64> {
            let [low, high] = range(x);
            x.iter().map(|x| x + by * (high - low)).collect()
        };
        let of = |input: f64, output: f64| {
            let inputs = vec![moved(&drawn.inputs[0], input)];
            let (motion, output) = (Some(inputs[0].clone()), moved(&drawn.output, output));
            document(
                &map(),
                &[Signals {
                    inputs,
                    motion,
                    output,
                    ..drawn.clone()
                }],
            )
        };
        let plain = of(0.0, 0.0);
        for (input, output) in [(-1e3, 1e6), (1e5, 0.0)] {
            let d = of(input, output);
            let at = format!(
                "{cause} {seed} at {input} {output}: {:?} {:?}",
                d.verdict, d.gap
            );
            assert_eq!(
                (d.verdict.kind, &d.verdict.names),
                (plain.verdict.kind, &plain.verdict.names),
                "{at}"
            );
            let figures = |d: &Document| [d.gap.recalibrated, d.gap.explained, d.gap.noise_floor];
            let sizes = |d: &Document| -> Vec<f64> {
                let of_set = d
                    .set
                    .iter()
                    .take(1)
                    .flat_map(|e| e.params.iter().map(|p| p.value));
                of_set.chain(figures(d)).collect()
            };
            for (a, b) in sizes(&d).into_iter().zip(sizes(&plain)) {
                assert!((a / b - 1.0).abs() < 1e-3, "{a} is not {b}: {at}");
            }
        }
    }
}

const MEASURED: [&str; 11] = [
    "delay",
    "lag",
    "play",
    "dead_band",
    "saturation",
    "asymmetry",
    "rate_limit",
    "creep",
    "periodic_position",
    "periodic_time",
    "leak",
];

/// Of a cause that follows its law, the parameter is in its interval and nothing but the noise is left.
#[test]
fn parameters_are_found_where_they_are() {
    let mut said = vec![];
    for cause in MEASURED {
        for seed in 0..8 {
            let drawn = draw(cause, seed);
            let (map, logs) = (map(), [drawn.signals]);
            let problem = RigProblem::new(&map, &logs, 1).unwrap();
            let operator = DRIVEN.iter().find(|o| o.name == cause).unwrap();
            // half of the log may not show the sign of an effect
            let Some(set) = problem.best(&[], operator) else {
                said.push((cause, seed, drawn.truth, [f64::NAN; 2], f64::NAN, false));
                continue;
            };
            let (m, left) = (&set.members[0], set.energy().sqrt() / drawn.noise);
            let held = (m.ci95[0]..=m.ci95[1]).contains(&drawn.truth);
            said.push((cause, seed, drawn.truth, m.ci95, left, held));
        }
    }
    let wrong: Vec<_> = said.iter().filter(|s| !s.5 || s.4 > 1.15).collect();
    let held = said.iter().filter(|s| s.5).count();
    assert!(
        held * 100 >= 85 * said.len(),
        "{held} of {}: {wrong:?}",
        said.len()
    );
    let noise = said.iter().filter(|s| s.4 <= 1.15).count();
    assert!(
        noise * 100 >= 95 * said.len(),
        "{noise} of {}: {wrong:?}",
        said.len()
    );
}

/// A long log is compared in few rows, which show what the log shows: of slow motion means of rows, of fast motion a stretch.
#[test]
fn a_long_log_shows_in_few_rows_what_it_shows() {
    let causes = ["delay", "lag", "play", "periodic_position"];
    for (seed, cause) in (20..).zip(causes) {
        for periods in [12.0, 600.0] {
            let drawn = drive(cause, &mut StdRng::seed_from_u64(seed), 60_000, periods);
            let logs = [drawn.signals.compared()];
            let rows = logs[0].t.len();
            let map = map();
            let problem = RigProblem::new(&map, &logs, 1).unwrap();
            let operator = DRIVEN.iter().find(|o| o.name == cause).unwrap();
            let set = problem.best(&[], operator).unwrap();
            let (m, left) = (&set.members[0], set.energy().sqrt() / drawn.noise);
            let [low, high] = m.ci95;
            assert!(
                rows <= ROWS_MAX && (low..=high).contains(&drawn.truth) && left < 1.15,
                "{cause} {periods}: {rows} rows, {} is not in {low} to {high}, {left}",
                drawn.truth
            );
        }
    }
}
