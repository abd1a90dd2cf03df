//! Where a fit of one more effect begins.
//!
//! An effect has several starting points where its error surface has several valleys. From each, a step
//! along the tangent says how much the sum of squares would fall; the most promising one is fitted. What
//! happens once has no gradient to its own time: a scan over the log finds it, by least squares over all
//! times at once.

use crate::diagnosis::chain::Model;
use crate::diagnosis::fit::{Point, bounds, extend, step};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::slope::Tangent;
use crate::model::effects::{Effect, Param};
use nalgebra::{Matrix3, Vector3};

/// A fit that another effect is to be added to.
pub struct BaseFit<'a> {
    /// Its model.
    pub model: Model<'a>,
    /// Where it ended.
    pub point: Point,
    /// The tangent there.
    pub tangent: Tangent,
}

/// A beginning and what it promises.
#[derive(Debug, Clone)]
pub struct Beginning {
    /// Parameters of the larger model.
    pub theta: Vec<f64>,
    /// Sum of squares after a step along the tangent.
    pub predicted_gain: f64,
}

/// The most promising beginning of `to`, which has the effect `added` more than the ground.
#[must_use]
pub fn begin(log: &Observed, base_fit: &BaseFit<'_>, to: &Model<'_>, added: &dyn Effect) -> Option<Beginning> {
    let mut starts = added.starts();
    if let Some(found) = scan(log, base_fit, to, added) {
        // what a scan finds stands for all starts that differ in time only
        starts.truncate(usize::from(added.stage() == crate::model::effects::Stage::Base));
        starts.push(found);
    }
    starts.iter().filter_map(|s| predicted_gain(log, base_fit, to, s)).min_by(|a, b| a.predicted_gain.total_cmp(&b.predicted_gain))
}

/// One Gauss-Newton step from a starting point, and the sum of squares that the tangent foretells.
fn predicted_gain(log: &Observed, base_fit: &BaseFit<'_>, to: &Model<'_>, fresh: &[f64]) -> Option<Beginning> {
    let (bounds, all) = (bounds(to), vec![1.0; log.bins.len()]);
    let theta = extend(&base_fit.model, &base_fit.point.theta, to, fresh);
    let theta = theta.iter().zip(&bounds).map(|(t, b)| t.clamp(b.low, b.high)).collect();
    let point = Point::new(log, to, &bounds, theta, &all);
    let tangent = Tangent::grown(log, to, &point, &bounds, &all, base_fit);
    let sums = tangent.sums(&point, &bounds, log.bins.len());
    let theta = step(&point.theta, &bounds, &sums, 1e-3)?;
    let way = nalgebra::DVector::from_iterator(theta.len(), (0..theta.len()).map(|i| (theta[i] - point.theta[i]) / bounds[i].scale));
    let foretold = point.total() + 2.0 * sums.slope.dot(&way) + (&sums.normal * &way).dot(&way);
    // a step too long for its tangent may promise the impossible
    Some(Beginning { theta, predicted_gain: foretold.max(0.02 * base_fit.point.total()) })
}

/// Indices of an event's time and its three offsets.
fn event(params: &[Param], which: usize) -> Option<(usize, [usize; 3])> {
    let time = params.iter().position(|p| p.name == format!("t{which}_s"))?;
    let names = [[format!("d{which}_1"), format!("d{which}_2"), format!("d{which}_3")], ["x", "y", "z"].map(|a| format!("{a}{which}"))];
    let offsets: Vec<usize> = (0..params.len()).filter(|&i| names.iter().flatten().any(|n| params[i].name == n)).collect();
    <[usize; 3]>::try_from(offsets).ok().map(|o| (time, o))
}

/// Times and offsets of the events that explain most of what is left, the largest first.
fn scan(log: &Observed, base_fit: &BaseFit<'_>, to: &Model<'_>, added: &dyn Effect) -> Option<Vec<f64>> {
    let params = added.params();
    event(params, 1)?;
    let (bounds, all) = (bounds(to), vec![1.0; log.bins.len()]);
    let mut fresh: Vec<f64> = params.iter().map(|p| p.start).collect();
    // quick events: a slow one has a start of its own
    for (value, p) in fresh.iter_mut().zip(params) {
        if p.name.starts_with("lasting") {
            *value = 0.5;
        }
    }
    for which in 1..=2 {
        let (time, offsets) = event(params, which)?;
        let residuals =
            |fresh: &[f64]| Point::new(log, to, &bounds, extend(&base_fit.model, &base_fit.point.theta, to, fresh), &all).residual;
        let mut early = fresh.clone();
        early[time] = 0.5;
        let r0 = residuals(&early);
        let columns = offsets.map(|i| {
            let mut moved = early.clone();
            moved[i] += params[i].scale;
            let mut c = residuals(&moved);
            c.iter_mut().zip(&r0).for_each(|(x, y)| *x = (*x - y) / params[i].scale);
            c
        });
        let (gain, bin, x) = best_time(log.bins.len(), &columns, &r0);
        if which == 2 && gain < 0.02 * base_fit.point.total() {
            break;
        }
        fresh[time] = log.bins[bin].t_s - log.start_s();
        for (&i, v) in offsets.iter().zip(x.iter()) {
            fresh[i] = v.clamp(params[i].low, params[i].high);
        }
    }
    Some(fresh)
}

/// The same model with every quick event dated anew, each while all else stays as fitted; `None` if the
/// model has no events.
#[must_use]
pub fn dated_anew(log: &Observed, model: &Model<'_>, theta: &[f64]) -> Option<Vec<f64>> {
    let (bounds, all) = (bounds(model), vec![1.0; log.bins.len()]);
    let (mut out, mut found) = (theta.to_vec(), false);
    for (i, e) in model.effects.iter().enumerate() {
        let (params, first) = (e.params(), model.at[i]);
        for which in 1..=2 {
            let Some((time, offsets)) = event(&params, which) else { continue };
            let lasting = params.iter().position(|p| p.name == format!("lasting{which}"));
            if lasting.is_some_and(|l| out[first + l] > QUICK_S) {
                continue;
            }
            let mut early = out.clone();
            early[first + time] = 0.5;
            offsets.iter().for_each(|&o| early[first + o] = 0.0);
            let r0 = Point::new(log, model, &bounds, early.clone(), &all).residual;
            let columns = offsets.map(|o| {
                let mut moved = early.clone();
                moved[first + o] += params[o].scale;
                let mut c = Point::new(log, model, &bounds, moved, &all).residual;
                c.iter_mut().zip(&r0).for_each(|(x, y)| *x = (*x - y) / params[o].scale);
                c
            });
            let (_, bin, x) = best_time(log.bins.len(), &columns, &r0);
            out[first + time] = log.bins[bin].t_s - log.start_s();
            for (&o, v) in offsets.iter().zip(x.iter()) {
                out[first + o] = v.clamp(params[o].low, params[o].high);
            }
            found = true;
        }
    }
    found.then_some(out)
}

/// Longest event that a step can stand for, s.
const QUICK_S: f64 = 5.0;

/// Where a step of three offsets lowers the squares of `r` most: how much, from which bin on, by what.
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
