//! Where the fit of an effect with periodic modes starts: their frequencies and amplitudes.
//!
//! The sum of squares has no gradient with respect to the frequency of a mode. What an event of the effect changes in the residuals tells
//! what its offsets change at any time, so a mode of a given frequency is linear least squares, and a scan over all frequencies that a log
//! shows finds the best: a periodogram (Lomb 1976) in the offsets. [`changes`] is also what dates events.

use crate::diagnosis::tip::fit::{BaseFit, LeastSquares, schwarz};
use crate::diagnosis::tip::observed::Segment;
use crate::model::effects::{Effect, MODE_PARAMS, catalogue};
use crate::model::{Event, Mode, Model};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Time to which an event is moved so that its offsets act on the whole log, s after the start: within the rest.
pub const EARLY_S: f64 = 1.5;
/// Duration of the events that a scan looks for, s; slower events have starting points of their own.
pub const SCANNED_S: f64 = 0.5;

/// Frequencies of the modes that a scan looks for, Hz, and the least number of their periods in the log.
const MODES_HZ: f64 = 1.0;
const PERIODS_MIN: f64 = 4.0;
/// Steps of the scan per resolution of the log, and the parts into which it divides the log, s.
const PER_RESOLUTION: f64 = 2.0;
const PART_S: f64 = 0.25;
/// Modes of other causes that are taken out before a scan gives up.
const OTHERS_MAX: usize = 2;

/// Parameters of an effect with periodic modes at those that explain most of what the base fit leaves, the largest first, as many as
/// Schwarz's criterion holds for significant; `None` without any. What the same mode of another effect's offsets explains better (of the
/// pistons, where a tip bends periodically) is taken out, and is none of this effect. Several logs have no common phase.
pub fn periodic(base: &BaseFit<'_>, to: &LeastSquares<'_>, added: &dyn Effect) -> Option<Vec<f64>> {
    let (log, model) = (to.log, &to.model);
    let effect = model.position(added.name())?;
    if added.modes() == 0 || log.segments.len() > 1 {
        return None;
    }
    let known = &base.problem.model;
    let mut theta = model.extended(known, &base.point.theta, vanishing);
    let mut r = to.residual_from_rest(&theta, EARLY_S);
    let own_columns = offsets(to, effect, &theta)?;
    let is_other = |e: &&&'static dyn Effect| e.info().is_event() && e.name() != added.name();
    let others = catalogue().iter().filter(is_other).map(|e| {
        let other = LeastSquares::new(log, Model::new(&[*e]));
        let theta = (other.model).extended(known, &base.point.theta, vanishing);
        offsets(&other, 0, &theta)
    });
    let others: Vec<Columns> = others.collect::<Option<_>>()?;
    let (mut modes, mut taken_out) = (model.modes(effect).peekable(), 0);
    while taken_out < OTHERS_MAX && modes.peek().is_some() {
        let best = |columns| best_mode(&parts(to, columns, &r), log.duration_s());
        let own = best(&own_columns)?;
        let of_others = others
            .iter()
            .filter_map(|columns| Some((columns, best(columns)?)));
        let other = of_others.max_by(|a, b| a.1.gain.total_cmp(&b.1.gain));
        let other = other.filter(|(_, other)| other.gain > own.gain);
        let is_own = other.is_none();
        let (columns, best) = other.unwrap_or((&own_columns, own));
        let left: f64 = r.iter().map(|r| r * r).sum();
        if schwarz(log, left - best.gain, MODE_PARAMS) > schwarz(log, left, 0) {
            break;
        }
        best.add_to(&mut r, to, columns);
        if !is_own {
            taken_out += 1;
        } else if let Some(Mode { frequency, offsets }) = modes.next() {
            theta[frequency] = best.hertz;
            for (&o, v) in offsets.iter().flatten().zip(best.offsets.iter()) {
                theta[o] = v.clamp(to.bounds[o].low, to.bounds[o].high);
            }
        }
    }
    let first = model.modes(effect).next()?;
    (theta[first.frequency] > 0.0).then(|| model.of(&theta, effect).to_vec())
}

/// Parameters at which an effect vanishes.
pub fn vanishing(effect: &dyn Effect) -> Vec<f64> {
    effect.params().iter().map(|p| p.start).collect()
}

/// What one unit of each offset of an event changes in the residuals `r0` of a segment from the rest on.
pub fn changes(
    problem: &LeastSquares<'_>,
    without: &[f64],
    event: &Event,
    segment: &Segment,
    r0: &[f64],
) -> [Vec<f64>; 3] {
    event.offsets.map(|o| {
        let (mut moved, scale) = (without.to_vec(), problem.bounds[o].scale);
        moved[event.time] = segment.start_s - problem.log.start_s() + EARLY_S;
        moved[o] = scale;
        let with = problem.residual_from_rest(&moved, EARLY_S);
        with.iter().zip(r0).map(|(x, y)| (x - y) / scale).collect()
    })
}

/// What one unit of each of three offsets changes in the residuals of a log.
type Columns = [Vec<f64>; 3];

/// The columns of the offsets of an effect's events.
fn offsets(problem: &LeastSquares<'_>, effect: usize, theta: &[f64]) -> Option<Columns> {
    let event = problem.model.events(effect).next()?;
    let mut without = theta.to_vec();
    event
        .lasting
        .into_iter()
        .for_each(|l| without[l] = SCANNED_S);
    let r0 = problem.residual_from_rest(&without, EARLY_S);
    let segment = &problem.log.segments[0];
    Some(changes(problem, &without, &event, segment, &r0))
}

/// What the rows of a part of a log say about three offsets at its time.
#[derive(Default)]
struct Part {
    t_s: f64,
    bins: f64,
    normal: Matrix3<f64>,
    gradient: Vector3<f64>,
}

/// What the residuals `r` say about offsets that change them by `columns`, part by part.
fn parts(problem: &LeastSquares<'_>, columns: &Columns, r: &[f64]) -> Vec<Part> {
    let log = problem.log;
    let stride = r.len() / log.bins.len();
    let mut out: Vec<Part> = Vec::new();
    let mut from_s = f64::NEG_INFINITY;
    for (k, bin) in log.bins.iter().enumerate() {
        if bin.t_s - from_s >= PART_S {
            from_s = bin.t_s;
            out.push(Part::default());
        }
        let Some(part) = out.last_mut() else { continue };
        part.bins += 1.0;
        part.t_s += (bin.t_s - log.start_s() - part.t_s) / part.bins;
        for i in k * stride..(k + 1) * stride {
            let d = Vector3::new(columns[0][i], columns[1][i], columns[2][i]);
            part.normal += d * d.transpose();
            part.gradient += d * r[i];
        }
    }
    out
}

/// A mode: what it lowers the squares by, its frequency, Hz, and the offsets of its sine and of its cosine.
struct Sinusoid {
    gain: f64,
    hertz: f64,
    offsets: Vector6<f64>,
}

impl Sinusoid {
    /// Adds what the mode changes to the residuals `r`.
    fn add_to(&self, r: &mut [f64], problem: &LeastSquares<'_>, columns: &Columns) {
        let log = problem.log;
        let stride = r.len() / log.bins.len();
        for (k, bin) in log.bins.iter().enumerate() {
            let (sine, cosine) = (TAU * self.hertz * (bin.t_s - log.start_s())).sin_cos();
            for i in k * stride..(k + 1) * stride {
                let along =
                    |axis: usize| self.offsets[axis] * sine + self.offsets[3 + axis] * cosine;
                r[i] += (0..3)
                    .map(|axis| columns[axis][i] * along(axis))
                    .sum::<f64>();
            }
        }
    }
}

/// The mode that lowers the squares most.
fn best_mode(parts: &[Part], duration_s: f64) -> Option<Sinusoid> {
    let step_hz = 1.0 / (PER_RESOLUTION * duration_s);
    let first = (PERIODS_MIN * PER_RESOLUTION).ceil() as usize;
    let frequencies = (first..=(MODES_HZ / step_hz) as usize).into_par_iter();
    let modes = frequencies.filter_map(|k| mode_at(parts, k as f64 * step_hz));
    modes.max_by(|a, b| a.gain.total_cmp(&b.gain))
}

/// The mode of this frequency.
fn mode_at(parts: &[Part], hertz: f64) -> Option<Sinusoid> {
    let (mut n, mut s) = (Matrix6::zeros(), Vector6::zeros());
    for part in parts {
        let (sine, cosine) = (TAU * hertz * part.t_s).sin_cos();
        let both = [sine, cosine];
        for (i, a) in both.iter().enumerate() {
            let mut own = s.fixed_rows_mut::<3>(3 * i);
            own += part.gradient * *a;
            for (j, b) in both[..=i].iter().enumerate() {
                let mut block = n.fixed_view_mut::<3, 3>(3 * i, 3 * j);
                block += part.normal * (a * b);
            }
        }
    }
    n.fill_upper_triangle_with_lower_triangle();
    let x = (n + Matrix6::identity() * 1e-6).try_inverse()? * s;
    Some(Sinusoid {
        gain: s.dot(&x),
        hertz,
        offsets: -x,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts of a log of 200 s whose offsets are seen along two axes with the given residuals, and not along the third.
    fn parts_of(offset: impl Fn(f64) -> Vector3<f64>) -> Vec<Part> {
        let part = |k: u32| {
            let t_s = f64::from(k) * PART_S;
            let normal = Matrix3::from_diagonal(&Vector3::new(40.0, 25.0, 0.0));
            Part {
                t_s,
                bins: 1.0,
                normal,
                gradient: -normal * offset(t_s),
            }
        };
        (0..800).map(part).collect()
    }

    #[test]
    fn a_mode_is_found_with_its_frequency_and_phase() {
        for hertz in [0.031, 0.2, 0.77] {
            let shown = parts_of(|t_s| {
                let (sine, cosine) = (TAU * hertz * t_s).sin_cos();
                Vector3::new(0.1 * sine - 0.05 * cosine, 0.02 * cosine, 0.3)
            });
            let found = best_mode(&shown, 200.0).unwrap();
            assert!((found.hertz - hertz).abs() < 1.0 / 200.0, "{}", found.hertz);
            let exact = mode_at(&shown, hertz).unwrap();
            let truth = Vector6::new(0.1, 0.0, 0.0, -0.05, 0.02, 0.0);
            assert!((exact.offsets - truth).amax() < 1e-3, "{}", exact.offsets);
            assert!(found.gain <= exact.gain * 1.001 && found.gain > 0.8 * exact.gain);
        }
    }
}
