//! Where the fit of one more effect starts.
//!
//! An effect whose error surface has several valleys has several starting points. One step along the tangent from each
//! predicts how far the sum of squares falls, and the fit starts at the best. The sum of squares has no gradient with
//! respect to the time of an event; a linear least-squares scan over all times of the log finds it.

use crate::diagnosis::fit::step;
use crate::diagnosis::problem::{Point, Problem};
use crate::diagnosis::tangent::{BaseFit, Tangent};
use crate::model::effects::{Effect, Stage};
use nalgebra::{DVector, Matrix3, Vector3};

/// Time to which an event is moved so that its offsets act on the whole log, s after the start: within the rest.
const EARLY_S: f64 = 1.5;
/// Duration of the events that a scan looks for, s; slower events have starting points of their own.
const SCANNED_S: f64 = 0.5;
/// Longest event that the step of a scan approximates, s.
const QUICK_S: f64 = 5.0;
/// Times that every event is dated while the others stay.
const DATED_ROUNDS: usize = 2;
/// Part of the sum of squares that every event after the first must remove.
const FURTHER_EVENT: f64 = 0.02;
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
#[must_use]
pub fn best_start(base: &BaseFit<'_>, to: &Problem<'_>, added: &dyn Effect) -> Option<Start> {
    let mut starts = added.starts();
    if let Some(found) = scan(base, to, added) {
        // the scan replaces the starts that differ in time only; the first start of a base motion is a slow turn
        starts.truncate(usize::from(added.stage() == Stage::Base));
        starts.push(found);
    }
    starts.iter().filter_map(|s| predict(base, to, s)).min_by(|a, b| a.predicted.total_cmp(&b.predicted))
}

/// One Gauss-Newton step from the base fit extended by `fresh`, and the sum of squares that the tangent predicts.
fn predict(base: &BaseFit<'_>, to: &Problem<'_>, fresh: &[f64]) -> Option<Start> {
    let point = to.at_clamped(&to.extended(&base.problem.model, &base.point.theta, fresh));
    let sums = Tangent::grown(to, &point, base).sums(to, &point);
    let theta = step(&point.theta, &to.bounds, &sums, DAMPING)?;
    let way = DVector::from_iterator(theta.len(), (0..theta.len()).map(|i| (theta[i] - point.theta[i]) / to.bounds[i].scale));
    let predicted = point.total() + 2.0 * sums.gradient.dot(&way) + (&sums.normal * &way).dot(&way);
    Some(Start { theta, predicted: predicted.max(CREDIBLE * base.point.total()) })
}

/// Indices in θ of one event of an event effect. Its parameters are one group per event: the time, the duration if the
/// event has one, and three offsets.
struct Event {
    time: usize,
    lasting: Option<usize>,
    offsets: [usize; 3],
}

impl Event {
    fn all(problem: &Problem<'_>, effect: usize) -> Vec<Self> {
        let (e, first) = (problem.model.effects[effect], problem.model.at[effect]);
        if !e.info().is_event() {
            return vec![];
        }
        let events = e.info().events;
        let size = e.params().len() / events;
        let group = |from: usize| Self {
            time: from,
            lasting: (size > 4).then_some(from + 1),
            offsets: std::array::from_fn(|i| from + size - 3 + i),
        };
        (0..events).map(|k| group(first + k * size)).collect()
    }

    /// Sets time and offsets to those that lower the sum of squares most; `false` if they lower it by less than `least`.
    fn date(&self, problem: &Problem<'_>, theta: &mut [f64], least: f64) -> bool {
        let mut early = theta.to_vec();
        early[self.time] = EARLY_S;
        self.offsets.iter().for_each(|&o| early[o] = 0.0);
        // gravity and field solved on the whole log would follow the event
        let r0 = problem.residual_from_rest(&early, EARLY_S);
        let columns = self.offsets.map(|o| {
            let (mut moved, scale) = (early.clone(), problem.bounds[o].scale);
            moved[o] += scale;
            problem.residual_from_rest(&moved, EARLY_S).iter().zip(&r0).map(|(x, y)| (x - y) / scale).collect()
        });
        let (gain, bin, offsets) = best_time(problem.log.bins.len(), &columns, &r0);
        if gain < least {
            return false;
        }
        theta[self.time] = problem.log.bins[bin].t_s - problem.log.start_s();
        for (&o, v) in self.offsets.iter().zip(offsets.iter()) {
            theta[o] = v.clamp(problem.bounds[o].low, problem.bounds[o].high);
        }
        true
    }
}

/// Parameters of an event effect at the events that explain most of what the base fit leaves, the largest first. Each is then
/// dated again while the others stay.
fn scan(base: &BaseFit<'_>, to: &Problem<'_>, added: &dyn Effect) -> Option<Vec<f64>> {
    let effect = to.model.effects.iter().position(|e| e.name() == added.name())?;
    let fresh: Vec<f64> = added.params().iter().map(|p| p.start).collect();
    let mut theta = to.extended(&base.problem.model, &base.point.theta, &fresh);
    let events = Event::all(to, effect);
    for lasting in events.iter().filter_map(|e| e.lasting) {
        theta[lasting] = SCANNED_S;
    }
    for (k, event) in events.iter().enumerate() {
        let least = if k == 0 { 0.0 } else { FURTHER_EVENT * base.point.total() };
        if !event.date(to, &mut theta, least) {
            break;
        }
    }
    for _ in 0..DATED_ROUNDS {
        events.iter().for_each(|e| _ = e.date(to, &mut theta, 0.0));
    }
    (!events.is_empty()).then(|| to.model.of(&theta, effect).to_vec())
}

/// Indices in θ of the times and durations of all events.
#[must_use]
pub fn dates(problem: &Problem<'_>) -> Vec<usize> {
    let events = (0..problem.model.effects.len()).flat_map(|i| Event::all(problem, i));
    events.flat_map(|e| [Some(e.time), e.lasting]).flatten().collect()
}

/// The parameters with every quick event dated again, each while all others stay as fitted; `None` if the model has no
/// quick events. With `slow_too` the slow events become quick ones; `None` if there are none.
#[must_use]
pub fn dated_again(problem: &Problem<'_>, point: &Point, slow_too: bool) -> Option<Vec<f64>> {
    let mut theta = point.theta.clone();
    let events: Vec<Event> = (0..problem.model.effects.len()).flat_map(|i| Event::all(problem, i)).collect();
    let quick: Vec<&Event> = events.iter().filter(|e| e.lasting.is_none_or(|l| slow_too || theta[l] <= QUICK_S)).collect();
    for lasting in quick.iter().filter_map(|e| e.lasting).filter(|_| slow_too) {
        theta[lasting] = SCANNED_S;
    }
    for _ in 0..DATED_ROUNDS {
        quick.iter().for_each(|e| _ = e.date(problem, &mut theta, 0.0));
    }
    let new = !quick.is_empty() && (!slow_too || quick.iter().any(|e| e.lasting.is_some_and(|l| point.theta[l] > QUICK_S)));
    new.then_some(theta)
}

/// The step of three offsets that lowers the squares of `r` most: its gain, its first bin, and the offsets. Offsets of the whole
/// log, such as a wrong base frame, are fitted beside it.
fn best_time(bins: usize, columns: &[Vec<f64>; 3], r: &[f64]) -> (f64, usize, Vector3<f64>) {
    let stride = r.len() / bins.max(1);
    let sums = |from: usize, to: usize| {
        (from..to).fold((Matrix3::zeros(), Vector3::zeros()), |(n, s): (Matrix3<f64>, Vector3<f64>), i| {
            let d = Vector3::new(columns[0][i], columns[1][i], columns[2][i]);
            (n + d * d.transpose(), s + d * r[i])
        })
    };
    let solved = |n: Matrix3<f64>, s: &Vector3<f64>| (n + Matrix3::identity() * 1e-6).try_inverse().map(|inverse| inverse * s);
    let (whole, of_whole) = sums(0, r.len());
    let (mut n, mut s) = (Matrix3::zeros(), Vector3::zeros());
    let mut best = (0.0, 0, Vector3::zeros());
    for k in (1..bins).rev() {
        let (dn, ds) = sums(k * stride, (k + 1) * stride);
        (n, s) = (n + dn, s + ds);
        // the offsets of the whole log are eliminated first
        let Some(shared) = (whole + Matrix3::identity() * 1e-6).try_inverse().map(|inverse| n * inverse) else { continue };
        let rest = s - shared * of_whole;
        let Some(x) = solved(n - shared * n, &rest) else { continue };
        let gain = rest.dot(&x);
        if gain > best.0 {
            best = (gain, k, -x);
        }
    }
    best
}
