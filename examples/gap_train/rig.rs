//! Random rigs: a nominal model driven by a random input, operators with a random change of form, small imperfections, and laws that no
//! operator has.

use super::contents;
use super::deform::{FOREIGN_DEPTH, Form};
use super::signals::{input, log_uniform, normal, ringing, sum, walk};
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use retroflex::diagnosis::rig::catalogue;
use retroflex::diagnosis::rig::file::Columns;
use retroflex::diagnosis::rig::regress;
use retroflex::diagnosis::rig::{
    DRIVEN, Drive, MapFile, Nominal, Operator, RESONANT, Signals, Task, variance,
};
use std::f64::consts::TAU;

/// Rows of a log.
const ROWS: [f64; 2] = [150.0, 2500.0];
/// White noise as a part of the output, 1 σ.
const NOISE: [f64; 2] = [3e-4, 0.05];
/// Largest size of an effect as a part of the output, RMS.
const LARGEST: f64 = 0.5;
/// Least size of an effect, in units of the noise.
const LEAST: f64 = 1.5;
/// Largest imperfection, in units of the noise.
const IMPERFECT: f64 = 0.7;
/// Largest depth of the change of form of an effect, twice that of a tip, of whose mechanics the catalogue knows more; and the depth below
/// which it is not made smaller.
const DEPTH: f64 = 0.5;
const LEAST_DEPTH: f64 = 0.02;
/// Share of an effect in another form that the effect must explain.
const ALIKE: f64 = 0.7;
/// Sizes of a curved spring, as a part of the linear force at the largest amplitude.
const CURVED: [f64; 2] = [0.01, 0.2];
/// Part of the mean square of the deviations that an effect must have to be in a label.
const VISIBLE: f64 = 0.03;
/// Travel and time that span a log for [`Form`], mm and s.
const FORM_SPAN: (f64, f64) = (20.0, 250.0);

/// A random rig and its log.
pub struct RandomRig {
    /// What the columns mean.
    pub map: MapFile,
    /// The log.
    pub signals: Signals,
    /// Names of the effects that can be claimed; `None` with a law that no operator has.
    pub truth: Option<Vec<&'static str>>,
}

/// The rig of a seed.
pub fn draw(seed: u64) -> RandomRig {
    let mut rng = StdRng::seed_from_u64(seed);
    let nominal = match rng.random_range(0..8) {
        0 => Nominal::Still,
        1 => Nominal::Resonance,
        _ => Nominal::Line,
    };
    let clocked = nominal != Nominal::Line || rng.random_bool(0.7);
    let rows = log_uniform(&mut rng, ROWS) as usize;
    let dt = if clocked {
        log_uniform(&mut rng, [0.002, 5.0])
    } else {
        1.0
    };
    let t: Vec<f64> = (0..rows).map(|k| k as f64 * dt).collect();
    let inputs: Vec<Vec<f64>> = (0..number_of_inputs(nominal, &mut rng))
        .map(|_| input(&mut rng, &t))
        .collect();
    let drive = drive(&inputs, &t, &mut rng);
    let noise = log_uniform(&mut rng, NOISE);
    let mut made = match nominal {
        Nominal::Resonance => Made::ringing(&inputs[0], &mut rng),
        Nominal::Line | Nominal::Still => Made {
            line: drive.v.clone(),
            deviation: vec![0.0; rows],
            truth: Some(vec![]),
        },
    };
    let imperfect = noise * rng.random_range(0.0..IMPERFECT);
    sum(
        &mut made.deviation,
        &scaled(&outside(&drive, &mut rng), &inputs, imperfect),
    );
    // the springs of an oscillator are drawn apart
    let known = if nominal == Nominal::Resonance {
        vec![]
    } else {
        catalogue(nominal, clocked)
    };
    for wanted in contents(known, &mut rng) {
        let law = match &wanted {
            Some(operator) => effect(operator, &drive, &inputs, &mut rng),
            None => outside(&drive, &mut rng),
        };
        let size = log_uniform(&mut rng, [LEAST * noise, LARGEST]);
        made.add(
            wanted.map(|o| o.name),
            &scaled(&law, &inputs, size),
            &inputs,
            noise,
        );
    }
    let output = made
        .line
        .iter()
        .zip(&made.deviation)
        .map(|(y, d)| y + d + noise * normal(&mut rng))
        .collect();
    RandomRig {
        map: map(nominal, inputs.len(), clocked.then_some(1.0 / dt)),
        signals: Signals {
            file: String::new(),
            motion: inputs.first().cloned(),
            inputs,
            output,
            logged: t.len(),
            t,
            clocked,
        },
        truth: made.truth,
    }
}

fn map(nominal: Nominal, inputs: usize, rate_hz: Option<f64>) -> MapFile {
    let input = (inputs > 0).then(|| Columns::Many((0..inputs).map(|k| k.to_string()).collect()));
    MapFile {
        input,
        output: Columns::One("y".to_owned()),
        motion: None,
        time: None,
        rate_hz,
        input_unit: String::new(),
        output_unit: String::new(),
        nominal,
        every: 1,
    }
}

/// A rig in the making.
struct Made {
    /// Output of the nominal model.
    line: Vec<f64>,
    /// What the effects and the imperfections add.
    deviation: Vec<f64>,
    truth: Option<Vec<&'static str>>,
}

impl Made {
    /// An oscillator whose spring may be curved.
    fn ringing(u: &[f64], rng: &mut StdRng) -> Self {
        let (wh, zeta) = (rng.random_range(0.1..0.6), rng.random_range(0.03..0.3));
        let curved = [(); 2].map(|()| {
            if rng.random_bool(0.5) {
                log_uniform(rng, CURVED) * [-1.0, 1.0][rng.random_range(0..2)]
            } else {
                0.0
            }
        });
        let of = |spring| ringing(u, spring, wh, zeta);
        let (line, whole) = (of([0.0; 2]), of(curved));
        let apart = |from: &[f64]| {
            whole
                .iter()
                .zip(from)
                .map(|(a, b)| a - b)
                .collect::<Vec<f64>>()
        };
        let deviation = apart(&line);
        let visible = |k: usize| {
            let mut without = curved;
            without[k] = 0.0;
            curved[k] != 0.0 && variance(&apart(&of(without))) > VISIBLE * variance(&deviation)
        };
        // the springs' own order is that of the catalogue: third power, square
        let names = (0..2)
            .filter(|&k| visible(1 - k))
            .map(|k| RESONANT[k].name)
            .collect();
        Self {
            line,
            deviation,
            truth: Some(names),
        }
    }

    /// Adds a law, unless it is too small to be claimed.
    fn add(&mut self, name: Option<&'static str>, law: &[f64], inputs: &[Vec<f64>], noise: f64) {
        let mut with = self.deviation.clone();
        sum(&mut with, law);
        let [before, after] = [&self.deviation, &with].map(|d| variance(&recalibrated(d, inputs)));
        if after - before > VISIBLE * after.max(noise * noise) {
            self.deviation = with;
            self.truth = name.and_then(|name| Some([self.truth.clone()?, vec![name]].concat()));
        }
    }
}

fn number_of_inputs(nominal: Nominal, rng: &mut StdRng) -> usize {
    match nominal {
        Nominal::Still => 0,
        Nominal::Resonance => 1,
        Nominal::Line if rng.random_bool(0.8) => 1,
        Nominal::Line => rng.random_range(2..4),
    }
}

/// The signals that operators act on. A rig without an input has none.
fn drive(inputs: &[Vec<f64>], t: &[f64], rng: &mut StdRng) -> Drive {
    let weights: Vec<f64> = inputs
        .iter()
        .map(|_| rng.random_range(0.3..1.0) * [-1.0, 1.0][rng.random_range(0..2)])
        .collect();
    let line: Vec<f64> = (0..t.len())
        .map(|k| inputs.iter().zip(&weights).map(|(u, w)| u[k] * w).sum())
        .collect();
    let unit = |x: &[f64]| {
        let (low, high) = x
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                (l.min(*v), h.max(*v))
            });
        let span = (high - low).max(1e-12);
        (
            x.iter().map(|v| (v - low) / span).collect::<Vec<f64>>(),
            span,
        )
    };
    let (m, m_range) = unit(inputs.first().unwrap_or(&line));
    Drive {
        v: unit(&line).0.iter().map(|x| 2.0 * x - 1.0).collect(),
        zero: {
            let low = line.iter().copied().fold(f64::INFINITY, f64::min);
            -2.0 * low / unit(&line).1 - 1.0
        },
        m,
        m_range,
        t: t.to_vec(),
        parts: vec![],
    }
}

/// The deviation by an operator at a random η, in a random form that a recalibrated model does not take for another law.
fn effect(operator: &Operator, drive: &Drive, inputs: &[Vec<f64>], rng: &mut StdRng) -> Vec<f64> {
    let law = pure(operator, drive, rng);
    let mut depth = rng.random_range(0.0..DEPTH);
    loop {
        let deformed = changed(&law, &Form::draw(rng, 1.0, depth), drive);
        if depth < LEAST_DEPTH
            || alike(
                &recalibrated(&law, inputs),
                &recalibrated(&deformed, inputs),
            )
        {
            return deformed;
        }
        depth /= 2.0;
    }
}

/// Whether one signal explains most of another.
fn alike(a: &[f64], b: &[f64]) -> bool {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    dot(a, b).powi(2) >= ALIKE * dot(a, a) * dot(b, b)
}

/// The deviation by an operator at a random η.
fn pure(operator: &Operator, drive: &Drive, rng: &mut StdRng) -> Vec<f64> {
    let eta = (operator.grid)(drive).choose(rng).copied().unwrap_or(0.0);
    let columns = (operator.columns)(drive, eta);
    let positive = operator.name == "hysteresis";
    let factors: Vec<f64> = (0..columns.len())
        .map(|k| {
            let z = normal(rng);
            match operator.sign {
                sign if sign != 0 && k == 0 => (0.3 + z.abs()) * f64::from(sign),
                _ if positive => z.abs(),
                _ => z,
            }
        })
        .collect();
    (0..drive.t.len())
        .map(|k| {
            columns
                .iter()
                .zip(&factors)
                .map(|(x, f)| f * x[k])
                .sum::<f64>()
        })
        .collect()
}

/// A law times a function of the drive and the time.
fn changed(law: &[f64], form: &Form, drive: &Drive) -> Vec<f64> {
    let ((travel, time), span) = (FORM_SPAN, drive.t[drive.t.len() - 1]);
    let at = |k: usize| {
        form.at(
            &(Vector3::new(drive.v[k], drive.m[k], 0.0) * travel),
            drive.t[k] / span * time,
        )
    };
    law.iter().enumerate().map(|(k, x)| x * at(k)).collect()
}

/// The deviation by a law that no operator has.
fn outside(drive: &Drive, rng: &mut StdRng) -> Vec<f64> {
    let (v, rows) = (&drive.v, drive.t.len());
    let span = drive.t[rows - 1];
    let phase = rng.random_range(0.0..TAU);
    match rng.random_range(0..7) {
        // a ripple over the drive that has no period
        0 => {
            let [first, rate] = [rng.random_range(0.5..4.0), rng.random_range(1.0..4.0)];
            v.iter()
                .map(|v| (TAU * (first * v + rate * v * v) + phase).sin())
                .collect()
        }
        // a wave in time whose frequency changes
        1 => {
            let [first, rate] = [rng.random_range(1.0..10.0), rng.random_range(3.0..30.0)];
            drive
                .t
                .iter()
                .map(|t| t / span)
                .map(|x| (TAU * (first * x + rate * x * x) + phase).sin())
                .collect()
        }
        // a disturbance of its own
        2 | 3 => walk(rows, rng),
        // a gain that wanders
        4 => walk(rows, rng).iter().zip(v).map(|(w, v)| w * v).collect(),
        // off while a memory of the drive is in a band
        5 => {
            let (keep, low) = (
                1.0 - 1.0 / rng.random_range(2.0..60.0),
                rng.random_range(-0.7..0.4),
            );
            let mut memory = 0.0;
            let jump = |v: &f64| {
                memory = keep * memory + (1.0 - keep) * v;
                f64::from(u8::from((low..low + 0.4).contains(&memory)))
            };
            v.iter().map(jump).collect()
        }
        // a law of the catalogue whose sign changes
        _ => changed(
            &pure(DRIVEN.choose(rng).unwrap_or(&DRIVEN[0]), drive, rng),
            &Form::draw(rng, 0.0, FOREIGN_DEPTH),
            drive,
        ),
    }
}

/// A law of which a recalibrated nominal model leaves this RMS.
fn scaled(law: &[f64], inputs: &[Vec<f64>], rms: f64) -> Vec<f64> {
    let left = variance(&recalibrated(law, inputs)).sqrt();
    // what is a straight line of the inputs but for rounding stays small
    let whole = (law.iter().map(|x| x * x).sum::<f64>() / law.len() as f64).sqrt();
    let now = left.max(1e-3 * whole).max(1e-12);
    law.iter().map(|x| x / now * rms).collect()
}

/// What a line of the inputs leaves of a signal.
fn recalibrated(y: &[f64], inputs: &[Vec<f64>]) -> Vec<f64> {
    let ones = vec![1.0; y.len()];
    let of: Vec<&[f64]> = [ones.as_slice()]
        .into_iter()
        .chain(inputs.iter().map(Vec::as_slice))
        .collect();
    let task = Task::new([y]);
    match task.regress(&regress::Columns::free(of.clone())) {
        Some(r) => regress::left(&task.y, &of, &r.coefficients),
        None => y.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use retroflex::diagnosis::diagnose;
    use retroflex::diagnosis::rig::{Document, RigProblem};
    use retroflex::diagnosis::verdict::VerdictKind;

    #[test]
    fn a_seed_gives_a_rig_and_another_gives_another() {
        assert_eq!(draw(3).signals, draw(3).signals);
        assert_ne!(draw(3).signals, draw(4).signals);
        assert!((0..100).all(|seed| draw(seed).signals.output.iter().all(|y| y.is_finite())));
    }

    /// On random rigs the verdict is the most probable statement and in its own 95 % set, `none` too; every single effect that leaves less than the
    /// verdict's set is in its group; a part whose interval holds zero is not claimed; and `unknown` is at least what stays structured.
    #[test]
    fn on_random_rigs_the_verdict_is_its_posterior() {
        for seed in 800_000..800_040 {
            let rig = draw(seed);
            let problem = RigProblem::new(&rig.map, std::slice::from_ref(&rig.signals), seed);
            let empty = || Document::empty(&rig.map);
            let d = problem.map_or_else(empty, |problem| diagnose(&problem).document);
            let v = &d.verdict;
            let Some(first) = v.conformal.first() else {
                assert_eq!(v.kind, VerdictKind::Unknown, "{seed}");
                continue;
            };
            assert_eq!(first.kind, v.kind, "{seed}: {v:?}");
            if v.kind != VerdictKind::Unknown {
                assert_eq!(first.names, v.names, "{seed}: {v:?}");
            }
            assert!(
                v.conformal
                    .iter()
                    .all(|s| s.probability <= first.probability)
            );
            if v.kind == VerdictKind::Effects {
                let set = &d.set[0];
                assert!(
                    set.closed_ci95[0] > 0.0 || v.names.len() > 1,
                    "{seed}: {set:?}"
                );
                let grouped = |name: &str| v.equivalent.iter().flatten().any(|n| *n == name);
                for e in d.effects.iter().filter(|e| e.rmse_after < set.rmse_after) {
                    assert!(
                        v.names.contains(&e.name.as_str()) || grouped(&e.name),
                        "{seed}: {}",
                        e.name
                    );
                }
            }
        }
    }
}
