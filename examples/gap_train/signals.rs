//! Random signals of training rigs.

use rand::RngExt;
use rand::rngs::StdRng;
use rand_distr::StandardNormal;
use retroflex::diagnosis::rig::{oscillator, oscillator_step};
use std::f64::consts::TAU;

/// A random drive: several sines, a triangle, steps, a smooth random walk, or ramps to random targets.
pub fn input(rng: &mut StdRng, t: &[f64]) -> Vec<f64> {
    let span = t[t.len() - 1];
    let cycles = rng.random_range(2.0..20.0);
    match rng.random_range(0..5) {
        0 => {
            let waves: Vec<(f64, f64)> = (0..3)
                .map(|_| {
                    (
                        cycles * rng.random_range(0.3..1.5),
                        rng.random_range(0.0..TAU),
                    )
                })
                .collect();
            let loud = rng.random_range(0.0..0.9);
            let at = |t: &f64| {
                (1.0 + loud * (TAU * t / span).sin())
                    * waves
                        .iter()
                        .map(|(f, p)| (TAU * f * t / span + p).sin())
                        .sum::<f64>()
            };
            t.iter().map(at).collect()
        }
        1 => t
            .iter()
            .map(|t| (cycles * t / span).fract())
            .map(|phase| (2.0 * phase - 1.0).abs())
            .collect(),
        kind => {
            let (mut now, mut target, mut left, mut speed) = (0.0, 0.0f64, 0, 1.0f64);
            let length = (t.len() as f64 / cycles / 2.0).max(4.0);
            let mut smooth = 0.0;
            let step = |_: &f64| {
                if left == 0 {
                    (target, left) = (
                        rng.random_range(-1.0..1.0),
                        (length * rng.random_range(0.3..1.7)) as usize + 1,
                    );
                    speed = 2.0 / length * rng.random_range(0.7..3.0);
                }
                left -= 1;
                now = if kind == 2 {
                    target
                } else {
                    now + (target - now).clamp(-speed, speed)
                };
                smooth += (now - smooth) * if kind == 3 { 4.0 / length } else { 1.0 };
                smooth
            };
            t.iter().map(step).collect()
        }
    }
}

/// A smooth random walk that returns to zero.
pub fn walk(rows: usize, rng: &mut StdRng) -> Vec<f64> {
    let keep = 1.0 - 1.0 / log_uniform(rng, [10.0, 200.0]);
    let (mut at, mut smooth) = (0.0, 0.0);
    let step = |_| {
        at = keep * at + (1.0 - keep) * normal(rng);
        smooth = keep * smooth + (1.0 - keep) * at;
        smooth
    };
    (0..rows).map(step).collect()
}

/// Output of an oscillator (`wh`, ζ as in [`oscillator`]) with the spring force `y + a y² + b y³`, driven so that the loudest output of the
/// linear one is 1.
pub fn ringing(u: &[f64], [a, b]: [f64; 2], wh: f64, zeta: f64) -> Vec<f64> {
    const ITERATIONS: usize = 6;
    let gain = 1.0
        / oscillator(u, wh, zeta)
            .iter()
            .fold(1e-6, |m: f64, y| m.max(y.abs()));
    let force = |u: f64, y: f64| gain * u - a * y * y - b * y * y * y;
    let (mut f, mut y) = (vec![gain * u[0]; 3], vec![gain * u[0]; 3]);
    for x in u {
        let n = y.len();
        let mut now: f64 = 2.0 * y[n - 1] - y[n - 2];
        // the trapezoidal rule is implicit in the force
        for _ in 0..ITERATIONS {
            let forces = [f[n - 2], f[n - 1], force(*x, now.clamp(-3.0, 3.0))];
            now = oscillator_step(forces, [y[n - 2], y[n - 1]], wh, zeta);
        }
        y.push(now.clamp(-3.0, 3.0));
        f.push(force(*x, y[n]));
    }
    y.split_off(3)
}

/// Adds one signal to another.
pub fn sum(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(a, b)| *a += b);
}

/// A normal value.
pub fn normal(rng: &mut StdRng) -> f64 {
    rng.sample(StandardNormal)
}

/// A value between two, uniform in the logarithm.
pub fn log_uniform(rng: &mut StdRng, [low, high]: [f64; 2]) -> f64 {
    low * (high / low).powf(rng.random())
}
