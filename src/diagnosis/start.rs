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

/// Events per effect.
const EVENTS: usize = 2;
/// Time to which an event is moved so that its offsets act on the whole log, s after the start.
const EARLY_S: f64 = 0.5;
/// Duration of the events that a scan looks for, s; slower events have starting points of their own.
const SCANNED_S: f64 = 0.5;
/// Longest event that the step of a scan approximates, s.
const QUICK_S: f64 = 5.0;
/// Part of the sum of squares that a second event must remove.
const SECOND_EVENT: f64 = 0.02;
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
        if !e.info().is_event {
            return vec![];
        }
        let size = e.params().len() / EVENTS;
        let group = |from: usize| Self {
            time: from,
            lasting: (size > 4).then_some(from + 1),
            offsets: std::array::from_fn(|i| from + size - 3 + i),
        };
        (0..EVENTS).map(|k| group(first + k * size)).collect()
    }

    /// Sets time and offsets to those that lower the sum of squares most; `false` if they lower it by less than `least`.
    fn date(&self, problem: &Problem<'_>, theta: &mut [f64], least: f64) -> bool {
        let mut early = theta.to_vec();
        early[self.time] = EARLY_S;
        self.offsets.iter().for_each(|&o| early[o] = 0.0);
        let r0 = problem.at(early.clone()).residual;
        let columns = self.offsets.map(|o| {
            let (mut moved, scale) = (early.clone(), problem.bounds[o].scale);
            moved[o] += scale;
            problem.at(moved).residual.iter().zip(&r0).map(|(x, y)| (x - y) / scale).collect()
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

/// Parameters of an event effect at the events that explain most of what the base fit leaves, the largest first.
fn scan(base: &BaseFit<'_>, to: &Problem<'_>, added: &dyn Effect) -> Option<Vec<f64>> {
    let effect = to.model.effects.iter().position(|e| e.name() == added.name())?;
    let fresh: Vec<f64> = added.params().iter().map(|p| p.start).collect();
    let mut theta = to.extended(&base.problem.model, &base.point.theta, &fresh);
    let events = Event::all(to, effect);
    for lasting in events.iter().filter_map(|e| e.lasting) {
        theta[lasting] = SCANNED_S;
    }
    for (k, event) in events.iter().enumerate() {
        let least = if k == 0 { 0.0 } else { SECOND_EVENT * base.point.total() };
        if !event.date(to, &mut theta, least) {
            break;
        }
    }
    (!events.is_empty()).then(|| to.model.of(&theta, effect).to_vec())
}

/// The parameters with every quick event dated again, each while all others stay as fitted; `None` if the model has no
/// quick events.
#[must_use]
pub fn dated_again(problem: &Problem<'_>, point: &Point) -> Option<Vec<f64>> {
    let mut theta = point.theta.clone();
    let events: Vec<Event> = (0..problem.model.effects.len()).flat_map(|i| Event::all(problem, i)).collect();
    let quick: Vec<&Event> = events.iter().filter(|e| e.lasting.is_none_or(|l| theta[l] <= QUICK_S)).collect();
    for event in &quick {
        event.date(problem, &mut theta, 0.0);
    }
    (!quick.is_empty()).then_some(theta)
}

/// The step of three offsets that lowers the squares of `r` most: its gain, its first bin, and the offsets.
fn best_time(bins: usize, columns: &[Vec<f64>; 3], r: &[f64]) -> (f64, usize, Vector3<f64>) {
    let stride = r.len() / bins.max(1);
    let (mut n, mut s) = (Matrix3::zeros(), Vector3::zeros());
    let mut best = (0.0, 0, Vector3::zeros());
    for k in (1..bins).rev() {
        for i in k * stride..(k + 1) * stride {
            let d = Vector3::new(columns[0][i], columns[1][i], columns[2][i]);
            n += d * d.transpose();
            s += d * r[i];
        }
        let Some(x) = (n + Matrix3::identity() * 1e-6).try_inverse().map(|inv| inv * s) else { continue };
        let gain = s.dot(&x);
        if gain > best.0 {
            best = (gain, k, -x);
        }
    }
    best
}
