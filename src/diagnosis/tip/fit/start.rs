//! Where the fit of one more effect starts.
//!
//! An effect whose error surface has several valleys has several starting points. One step along the tangent from each
//! predicts how far the sum of squares falls, and the fit starts at the best. The sum of squares has no gradient with
//! respect to the time of an event; a linear least-squares scan over all times of the log finds it. [`super::modes`] finds frequencies.

use crate::diagnosis::tip::fit::modes::{EARLY_S, SCANNED_S, changes, periodic, vanishing};
use crate::diagnosis::tip::fit::{BaseFit, LeastSquares, Sums, Tangent, schwarz, step, within};
use crate::diagnosis::tip::observed::Segment;
use crate::model::effects::{Effect, Stage};
use crate::model::{Event, Model};
use nalgebra::{DVector, Matrix3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// Longest event that the step of a scan approximates, s.
const QUICK_S: f64 = 5.0;
/// Times that every event is dated again while the others stay.
const DATED_ROUNDS: usize = 2;
/// Least part of the sum of squares that a tangent can be trusted to leave.
const CREDIBLE: f64 = 0.02;
/// Damping of the step that predicts the gain.
const DAMPING: f64 = 1e-3;

/// A starting point with the sum of squares predicted after one step.
#[derive(Debug, Clone)]
pub struct Start {
    /// Parameters after the step.
    pub theta: Vec<f64>,
    /// Predicted sum of squares.
    pub predicted: f64,
}

/// The most promising start of `to`, the base fit with the effect `added`.
pub fn best_start(base: &BaseFit<'_>, to: &LeastSquares<'_>, added: &dyn Effect) -> Option<Start> {
    let mut starts = added.starts();
    if let Some(found) = scan(base, to, added) {
        // the scan replaces the starts that differ in time only; the first start of a base motion is a slow turn
        starts.truncate(usize::from(added.stage() == Stage::Base));
        starts.push(found);
    }
    starts.extend(periodic(base, to, added));
    let predicted = starts.iter().filter_map(|s| predict(base, to, s));
    let criterion = |s: &Start| schwarz(to.log, s.predicted, to.model.present(&s.theta));
    predicted.min_by(|a, b| criterion(a).total_cmp(&criterion(b)))
}

/// The sets with one effect of a catalogue more than a fit, each with its most promising start.
pub fn grown(base: &BaseFit<'_>, catalogue: &[&'static dyn Effect]) -> Vec<(Model, Start)> {
    let known = base.problem.model.names();
    let one = |e: &&'static dyn Effect| {
        let names = [known.as_slice(), &[e.name()]].concat();
        let to = LeastSquares::new(base.problem.log, Model::named(catalogue, &names));
        best_start(base, &to, *e).map(|start| (to.model, start))
    };
    let others = catalogue.par_iter().filter(|e| !known.contains(&e.name()));
    others.filter_map(one).collect()
}

/// One Gauss-Newton step from the base fit extended by `fresh`, and the sum of squares that the tangent predicts.
fn predict(base: &BaseFit<'_>, to: &LeastSquares<'_>, fresh: &[f64]) -> Option<Start> {
    let known = &base.problem.model;
    let extended = to
        .model
        .extended(known, &base.point.theta, |_| fresh.to_vec());
    let point = to.at(within(extended, &to.bounds));
    let sums = Tangent::grown(to, &point, base).sums(to, &point);
    stepped(to, &point.theta, point.total(), &sums, base)
}

/// One Gauss-Newton step from θ with this sum of squares, and the sum of squares that the tangent predicts; `base` bounds what can be
/// trusted.
pub fn stepped(
    to: &LeastSquares<'_>,
    theta: &[f64],
    squares: f64,
    sums: &Sums,
    base: &BaseFit<'_>,
) -> Option<Start> {
    let next = step(theta, &to.bounds, sums, DAMPING)?;
    let way = |i: usize, _| (next[i] - theta[i]) / to.bounds[i].scale;
    let way = DVector::from_fn(theta.len(), way);
    let predicted = squares + 2.0 * sums.gradient.dot(&way) + (&sums.normal * &way).dot(&way);
    Some(Start {
        theta: next,
        predicted: predicted.max(CREDIBLE * base.point.total()),
    })
}

/// Dates the events of one effect, each while the others stay, and all of them `rounds` times. What their offsets would change from the rest
/// of a log on tells the date. It is found with all of them absent: an event changes little of what another one does.
fn date(problem: &LeastSquares<'_>, theta: &mut [f64], events: &[Event], rounds: usize) {
    let Some(first) = events.first() else { return };
    let (log, mut without) = (problem.log, theta.to_vec());
    let offsets = events.iter().flat_map(|e| e.offsets);
    offsets.for_each(|o| without[o] = 0.0);
    let r0 = problem.residual_from_rest(&without, EARLY_S);
    let change = |segment: &Segment| changes(problem, &without, first, segment, &r0);
    let changes: Vec<[Vec<f64>; 3]> = log.segments.iter().map(change).collect();
    for event in (0..rounds).flat_map(|_| events) {
        event.offsets.iter().for_each(|&o| theta[o] = 0.0);
        // gravity and field solved on the whole log would follow the event
        let r = problem.residual_from_rest(theta, EARLY_S);
        let stride = r.len() / log.bins.len();
        let parts = log.segments.iter().zip(&changes);
        let of = parts.map(|(s, columns)| best_time(s.bins.clone(), stride, columns, &r));
        let Some((_, bin, offsets)) = of.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            continue;
        };
        theta[event.time] = log.bins[bin].t_s - log.start_s();
        for (&o, v) in event.offsets.iter().zip(offsets.iter()) {
            theta[o] = v.clamp(problem.bounds[o].low, problem.bounds[o].high);
        }
    }
}

/// Parameters of an event effect at the events that explain most of what the base fit leaves, the largest first. Each is then
/// dated again while the others stay.
fn scan(base: &BaseFit<'_>, to: &LeastSquares<'_>, added: &dyn Effect) -> Option<Vec<f64>> {
    let model = &to.model;
    let effect = model.position(added.name())?;
    let mut theta = model.extended(&base.problem.model, &base.point.theta, vanishing);
    let events: Vec<Event> = model.events(effect).collect();
    for lasting in events.iter().filter_map(|e| e.lasting) {
        theta[lasting] = SCANNED_S;
    }
    date(to, &mut theta, &events, DATED_ROUNDS + 1);
    (!events.is_empty()).then(|| model.of(&theta, effect).to_vec())
}

/// The parameters with every quick event dated again, each while all others stay as fitted; `None` if the model has no
/// quick events. With `slow_too` the slow events become quick ones; `None` if there are none.
pub fn dated_again(fit: &BaseFit<'_>, slow_too: bool) -> Option<Vec<f64>> {
    let (problem, point) = (&fit.problem, &fit.point);
    let is_slow = |e: &Event| e.lasting.is_some_and(|l| point.theta[l] > QUICK_S);
    if slow_too && !problem.model.all_events().any(|e| is_slow(&e)) {
        return None;
    }
    let (mut theta, mut any) = (point.theta.clone(), false);
    for effect in 0..problem.model.effects.len() {
        let events = problem.model.events(effect);
        let quick: Vec<Event> = events.filter(|e| slow_too || !is_slow(e)).collect();
        for lasting in quick.iter().filter_map(|e| e.lasting).filter(|_| slow_too) {
            theta[lasting] = SCANNED_S;
        }
        date(problem, &mut theta, &quick, DATED_ROUNDS);
        any |= !quick.is_empty();
    }
    any.then_some(theta)
}

/// The step of three offsets that lowers the squares of `r` most within `bins`, of `stride` rows each: its gain, its first bin, and
/// the offsets. Offsets of the whole log, such as a wrong base frame, are fitted beside it.
fn best_time(
    bins: Range<usize>,
    stride: usize,
    columns: &[Vec<f64>; 3],
    r: &[f64],
) -> (f64, usize, Vector3<f64>) {
    let sums = |bins: Range<usize>| {
        let (mut n, mut s) = (Matrix3::zeros(), Vector3::zeros());
        for i in bins.start * stride..bins.end * stride {
            let d = Vector3::new(columns[0][i], columns[1][i], columns[2][i]);
            (n, s) = (n + d * d.transpose(), s + d * r[i]);
        }
        (n, s)
    };
    let inverse = |n: Matrix3<f64>| (n + Matrix3::identity() * 1e-6).try_inverse();
    let mut best = (0.0, bins.start, Vector3::zeros());
    let (whole, of_whole) = sums(bins.clone());
    let Some(inverse_of_whole) = inverse(whole) else {
        return best;
    };
    let (mut n, mut s) = (Matrix3::zeros(), Vector3::zeros());
    for k in (bins.start + 1..bins.end).rev() {
        let (dn, ds) = sums(k..k + 1);
        (n, s) = (n + dn, s + ds);
        // the offsets of the whole log are eliminated first
        let shared = n * inverse_of_whole;
        let rest = s - shared * of_whole;
        let Some(x) = inverse(n - shared * n).map(|inverse| inverse * rest) else {
            continue;
        };
        let gain = rest.dot(&x);
        if gain > best.0 {
            best = (gain, k, -x);
        }
    }
    best
}
