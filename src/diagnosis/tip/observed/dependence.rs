//! What is left of a log depends on something: the reading, the timing, the time, the pistons.
//!
//! A cause that the catalogue lacks usually still follows something that the log holds. For each [`Dependence`], a linear regression of
//! the residual on it, fitted on every other block, predicts the remaining blocks. A sensor that distorts rates, for one, hardly shows
//! in a score, because a bin in motion weighs little, but its residual follows the reading.

use crate::diagnosis::tip::fit::{BLOCKS_S, density};
use crate::diagnosis::tip::model::Residuals;
use crate::diagnosis::tip::observed::{Bin, G_M_S2, Observed, Quantity, between};
use crate::named;
use nalgebra::{SMatrix, SVector, Vector3};
use serde::Serialize;

/// Inputs of a regression, the constant among them.
const INPUTS: usize = 7;
/// Ridge for inputs that hardly vary, as a share of the samples; every input is scaled to a mean square of one.
const RIDGE: f64 = 0.02;
/// Time constant of a memory of the motion, s.
const MEMORY_S: f64 = 3.0;

type Inputs = SVector<f64, INPUTS>;

named! {
    /// What a residual may depend on.
    #[derive(Debug, Clone, Copy)]
    pub enum Dependence {
        /// The reading itself: scale, cross-axis terms, misalignment.
        Reading = "reading",
        /// The rate of change of the reading, constant or drifting: a clock.
        Timing = "timing",
        /// The time since the start.
        Time = "time",
        /// The pistons and their products.
        Pistons = "pistons",
        /// The sides from which the pistons came.
        Direction = "direction of the pistons",
        /// The time for which the pistons have stood.
        Idle = "time at rest",
    }
}

/// A dependence, and what it takes from the residual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Depends {
    /// On what: the name of a [`Dependence`].
    pub name: &'static str,
    /// Reduction of the density of left-out blocks by the regression.
    #[serde(skip)]
    pub gain: f64,
    /// Part of the residual's energy that it predicts on left-out blocks, of the sensor of which it predicts most.
    pub share: f64,
}

/// How far the residuals depend on each of [`Dependence::ALL`].
pub fn dependences(log: &Observed, residual: &Residuals) -> Vec<Depends> {
    let mean_density = |r: &Residuals| log.mean(&density(log, r, BLOCKS_S[0]));
    let before = mean_density(residual);
    let motion = motion(log);
    let of = |on: Dependence| {
        let mut left = residual.clone();
        let mut share: f64 = 0.0;
        for q in log.quantities() {
            let input = |k: usize| inputs(log, on, q, k, &motion[k], &residual[q][k]);
            let inputs: Vec<Inputs> = (0..log.bins.len()).map(input).collect();
            let (after, predicted) = regressed(log, q, &residual[q], &inputs);
            left[q] = after;
            share = share.max(predicted);
        }
        Depends {
            name: on.name(),
            gain: before - mean_density(&left),
            share,
        }
    };
    Dependence::ALL.map(of).to_vec()
}

/// Residual of a sensor less what the inputs predict on blocks outside the regression, and the part of its energy that they predict.
fn regressed(
    log: &Observed,
    q: Quantity,
    residual: &[Vector3<f64>],
    inputs: &[Inputs],
) -> (Vec<Vector3<f64>>, f64) {
    let used = |k: usize| log.bins[k].weight[q] > 0.0 && residual[k] != Vector3::zeros();
    let samples: Vec<usize> = (0..log.bins.len()).filter(|&k| used(k)).collect();
    let fold = |k: usize| ((log.bins[k].t_s - log.start_s()) / BLOCKS_S[0]) as usize % 2;
    let square = samples.iter().fold(Inputs::zeros(), |sum, &k| {
        sum + inputs[k].component_mul(&inputs[k])
    }) / samples.len().max(1) as f64;
    let scale = square.map(|s| if s > 1e-12 { 1.0 / s.sqrt() } else { 0.0 });
    let x = |k: usize| inputs[k].component_mul(&scale);
    let mut left = residual.to_vec();
    for out in 0..2 {
        let mut n = SMatrix::<f64, INPUTS, INPUTS>::zeros();
        let mut s = SMatrix::<f64, INPUTS, 3>::zeros();
        let mut weight = 0.0;
        for &k in samples.iter().filter(|&&k| fold(k) != out) {
            let w = log.bins[k].weight[q].powi(2);
            n += x(k) * x(k).transpose() * w;
            s += x(k) * residual[k].transpose() * w;
            weight += w;
        }
        n += SMatrix::identity() * (RIDGE * weight).max(f64::MIN_POSITIVE);
        let Some(inverse) = n.try_inverse() else {
            continue;
        };
        let law = inverse * s;
        for &k in samples.iter().filter(|&&k| fold(k) == out) {
            left[k] -= law.transpose() * x(k);
        }
    }
    let energy = |r: &[Vector3<f64>]| {
        let of = |&k: &usize| r[k].norm_squared() * log.bins[k].weight[q].powi(2);
        samples.iter().map(of).sum::<f64>()
    };
    let share = 1.0 - energy(&left) / energy(residual).max(f64::MIN_POSITIVE);
    (left, share.max(0.0))
}

/// The motion, bin by bin: the side from which each piston came to rest, or moves (±1, 0 before it has moved), and its travel, forgotten with
/// [`MEMORY_S`], mm.
fn motion(log: &Observed) -> Vec<[Vector3<f64>; 2]> {
    let (mut side, mut recent_mm) = (Vector3::zeros(), Vector3::zeros());
    let first = log.bins.first();
    let mut before = first.map_or_else(Vector3::zeros, |b| log.instants[b.at].piston_mm);
    let one = |bin: &Bin| {
        let moved = log.instants[bin.at].piston_mm - before;
        before += moved;
        side = side.zip_map(&moved, |s: f64, m| if m == 0.0 { s } else { m.signum() });
        recent_mm = recent_mm * (-bin.lasting_s / MEMORY_S).exp() + moved;
        [side, recent_mm]
    };
    log.bins.iter().map(one).collect()
}

/// Inputs at a bin with this motion and this residual.
fn inputs(
    log: &Observed,
    on: Dependence,
    q: Quantity,
    k: usize,
    [side, recent_mm]: &[Vector3<f64>; 2],
    residual: &Vector3<f64>,
) -> Inputs {
    let bin = &log.bins[k];
    let u = log.instants[bin.at].piston_mm;
    let t = (bin.t_s - log.start_s()) / log.duration_s() * 2.0 - 1.0;
    let power = |n| Vector3::new(t.powi(n), t.powi(n + 1), t.powi(n + 2));
    let [a, b] = match on {
        Dependence::Reading => [reading(log, q, k) - residual, Vector3::zeros()],
        Dependence::Timing => [1.0, t].map(|by| change(log, q, k) * by),
        Dependence::Time => [power(1), power(4)],
        Dependence::Pistons => [u, u.component_mul(&u.yzx())],
        Dependence::Direction => [*side, side.component_mul(&u)],
        Dependence::Idle => [*recent_mm, u * (-bin.idle_s / MEMORY_S).exp()],
    };
    Inputs::from_iterator(a.iter().chain(b.iter()).copied().chain([1.0]))
}

/// Rate of change of a reading at a bin, 1/s.
fn change(log: &Observed, q: Quantity, k: usize) -> Vector3<f64> {
    let (a, b) = (k.saturating_sub(1), (k + 1).min(log.bins.len() - 1));
    let span_s = log.bins[b].t_s - log.bins[a].t_s;
    if log.bins[k].speed_mm_s == 0.0 || span_s <= 0.0 {
        return Vector3::zeros();
    }
    let change = match q {
        Quantity::Reference => between(&log.bins[a].reference, &log.bins[b].reference),
        _ => reading(log, q, b) - reading(log, q, a),
    };
    if change.x.is_nan() {
        return Vector3::zeros();
    }
    change / span_s
}

/// A reading in the unit of its residual; for the tracker the vertical of the base in the axes of the tip. Not a number where it is missing.
fn reading(log: &Observed, q: Quantity, k: usize) -> Vector3<f64> {
    let bin = &log.bins[k];
    let segment = log.segments.first();
    let field_ut = segment.map_or(1.0, |s| s.rest.field_ut.norm().max(1.0));
    match q {
        Quantity::Reference => bin.reference.transpose() * Vector3::z(),
        Quantity::Acc => bin.acc / G_M_S2,
        Quantity::Mag => bin.mag / field_ut,
        Quantity::Gyro => bin.gyr,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::tip::observed::{PerQuantity, Row};

    /// A gyroscope in motion for four minutes, whose residual is `law` of the reading and the time (s) and some noise.
    fn strongest(law: impl Fn(Vector3<f64>, f64) -> Vector3<f64>) -> Depends {
        let mut log = Observed {
            has: PerQuantity([false, false, false, true]),
            ..Observed::default()
        };
        let mut residual = Residuals::default();
        for k in 0..4800 {
            let t_s = f64::from(k) * 0.05;
            let rate = Vector3::new(
                (1.1 * t_s).sin(),
                (0.7 * t_s).cos(),
                0.3 * (0.4 * t_s).sin(),
            );
            let noise =
                Vector3::new((37.0 * t_s).sin(), (53.0 * t_s).sin(), (71.0 * t_s).sin()) * 0.02;
            let left = law(rate, t_s) + noise;
            log.bins.push(Bin {
                t_s,
                lasting_s: 0.05,
                gyr: rate + left,
                weight: PerQuantity([0.0, 0.0, 0.0, 50.0]),
                speed_mm_s: 1.0,
                at: k as usize,
                ..Bin::default()
            });
            let row = Row {
                t_s,
                ..Row::default()
            };
            log.instants.push(row);
            log.rows.push(row);
            residual[Quantity::Gyro].push(left);
        }
        dependences(&log, &residual)
            .into_iter()
            .max_by(|a, b| a.gain.total_cmp(&b.gain))
            .unwrap()
    }

    #[test]
    fn a_wrong_scale_a_drift_and_noise_are_told_apart() {
        let scale = strongest(|rate, _| rate * 0.1);
        assert!(scale.name == "reading" && scale.share > 0.7, "{scale:?}");
        let drift = strongest(|_, t_s| Vector3::new(t_s - 120.0, 0.0, 0.0) * 1e-3);
        assert!(drift.name == "time" && drift.share > 0.7, "{drift:?}");
        let noise = strongest(|_, _| Vector3::zeros());
        assert!(noise.share < 0.05 && noise.gain < 0.05, "{noise:?}");
    }
}
