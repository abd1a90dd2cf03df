//! Distances between the effects on a schedule.
//!
//! `D_ij² = min over θ_nominal, θ_j of ‖δ_i − J_0 Δθ_nominal − J_j Δθ_j‖²`, in standard deviations: the change that effect i
//! makes to the readings, less what a recalibration and effect j can imitate. It is the non-centrality of the test of
//! i against j, and 0 for effects that the schedule cannot separate. All distances follow from one Gram matrix of
//! weighted residual differences. Imitation is linearised about the points of each effect (slopes at the first point,
//! and the other points as directions).

use crate::diagnosis::excite::{Machine, ScheduleRow, synthetic};
use crate::diagnosis::tip::SavedModel;
use crate::diagnosis::tip::model::residuals;
use crate::diagnosis::tip::observed::{CORRELATED_S, Observed};
use crate::model::effects::{Effect, Param};
use crate::model::{Model, NOMINAL, nominal_theta};
use nalgebra::DMatrix;
use rand::RngExt;
use rand::rngs::StdRng;
use rayon::prelude::*;
use std::ops::Range;

/// Largest span over which the bins of a hold are pooled, s.
const POOLED_S: f64 = 0.5;
/// Finite-difference step as a fraction of a parameter's scale.
const STEP: f64 = 0.01;
/// Scales of the nominal parameters: ln(1 + k_ε), k_λ (mm), τ₀ (s).
const NOMINAL_SCALE: [f64; 3] = [0.05, 0.1, 0.005];
/// Weight of a parameter's prior, 1/σ² in units of its scale.
const PRIOR: f64 = 1.0;
/// Draws per effect.
const DRAWS: usize = 2;
/// A time with a wider prior than this is that of an event and is drawn within the log, s.
const EVENT_SIGMA_S: f64 = 50.0;
/// Events of an effect that a schedule is judged by. More would imitate everything.
const EVENTS_MAX: usize = 2;
/// Range of the times of events, s.
const EVENTS_S: (f64, f64) = (20.0, 150.0);

/// An effect with the points at which it is evaluated; slopes are taken at the first.
pub struct Rival {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Parameter vectors.
    pub points: Vec<Vec<f64>>,
}

impl Rival {
    /// An effect at the values of a saved model or, if the model does not have it, at draws from its prior, of which events after the second
    /// do not happen. The draws are taken in either case, so that they do not depend on the model. Distances grow with the sizes of the
    /// effects; the draws determine the direction only, and the design gives all effects the same size, so that a wide prior does not make an
    /// effect look easy to find.
    pub fn new(effect: &'static dyn Effect, model: Option<&SavedModel>, rng: &mut StdRng) -> Self {
        let (params, counted) = (effect.params(), counted(effect));
        let mut value = |(i, p): (usize, &Param)| if i < counted { draw(p, rng) } else { p.start };
        let mut point = || params.iter().enumerate().map(&mut value).collect();
        let drawn = (0..DRAWS).map(|_| point()).collect();
        let saved = model.and_then(|m| m.params_of(effect));
        let points = saved.map_or(drawn, |point| vec![point]);
        Self { effect, points }
    }
}

/// Number of parameters by which a schedule is judged.
fn counted(effect: &dyn Effect) -> usize {
    effect.event_params() * effect.info().events.clamp(1, EVENTS_MAX)
}

/// A value 0.3 to 1.2 prior σ from the value without effect, on either side if the limits allow both.
fn draw(p: &Param, rng: &mut StdRng) -> f64 {
    if p.unit == "s" && p.scale > EVENT_SIGMA_S {
        return rng.random_range(EVENTS_S.0..EVENTS_S.1);
    }
    let two_sided = p.low < p.start - 0.1 * p.scale;
    let mirrored = two_sided && rng.random_bool(0.5);
    let sign = if mirrored { -1.0 } else { 1.0 };
    (p.start + sign * p.scale * rng.random_range(0.3..1.2)).clamp(p.low, p.high)
}

/// Columns of one effect in the Gram matrix, from and to.
struct Span {
    slopes: Range<usize>,
    points: Range<usize>,
}

/// What a schedule reveals about each effect.
pub struct Information {
    gram: DMatrix<f64>,
    spans: Vec<Span>,
}

/// Runs every rival over a schedule; `None` if the schedule is too short or moves too little to be diagnosed.
pub fn information(
    machine: &Machine,
    rows: &[ScheduleRow],
    rivals: &[Rival],
    tracker: bool,
    seed: u64,
) -> Option<Information> {
    let (piston_mm, _) = machine.drive(rows, synthetic::PERIOD_S);
    let log = synthetic::observed(machine, piston_mm, tracker, seed).ok()?;
    let start = nominal_theta(&machine.lines, machine.rig.prior_lag_s);
    let none = Model::new(&[]);
    let base = residual(&log, &none, &start);
    let slope = |i: usize| {
        let mut theta = start.clone();
        theta[i] += NOMINAL_SCALE[i / 3] * STEP;
        difference(&residual(&log, &none, &theta), &base, STEP)
    };
    let mut columns: Vec<Vec<f64>> = (0..NOMINAL).map(slope).collect();
    let each = rivals.par_iter();
    let each = each.map(|r| columns_of(&log, r, &start, &base));
    let each: Vec<Vec<Vec<f64>>> = each.collect();
    let mut spans = Vec::new();
    for (rival, own) in rivals.iter().zip(each) {
        let (first, slopes) = (columns.len(), counted(rival.effect));
        spans.push(Span {
            slopes: first..first + slopes,
            points: first + slopes..first + own.len(),
        });
        columns.extend(own);
    }
    let matrix = DMatrix::from_iterator(base.len(), columns.len(), columns.into_iter().flatten());
    // a plain product is blocked for the cache, `tr_mul` is not
    let gram = matrix.transpose() * &matrix * (synthetic::PERIOD_S / CORRELATED_S);
    let gram = clear_of_nominal(gram);
    Some(Information { gram, spans })
}

fn difference(to: &[f64], from: &[f64], by: f64) -> Vec<f64> {
    to.iter().zip(from).map(|(a, b)| (a - b) / by).collect()
}

/// Slopes at the first point in units of scale, then the change that each point makes.
fn columns_of(log: &Observed, rival: &Rival, start: &[f64], base: &[f64]) -> Vec<Vec<f64>> {
    let model = Model::new(&[rival.effect]);
    let at = |point: &[f64]| residual(log, &model, &[start, point].concat());
    let here = at(&rival.points[0]);
    let mut out = Vec::new();
    let counted = counted(rival.effect);
    for (i, p) in rival.effect.params().iter().take(counted).enumerate() {
        let mut moved = rival.points[0].clone();
        let beyond = moved[i] + STEP * p.scale > p.high;
        let h = if beyond { -STEP } else { STEP };
        moved[i] += h * p.scale;
        out.push(difference(&at(&moved), &here, h));
    }
    out.push(difference(&here, base, 1.0));
    let further = rival.points[1..].iter();
    out.extend(further.map(|p| difference(&at(p), base, 1.0)));
    out
}

/// Weighted residuals, the bins of a hold pooled.
fn residual(log: &Observed, model: &Model, theta: &[f64]) -> Vec<f64> {
    let residual = residuals(log, model, theta);
    let mut out = Vec::new();
    let mut k = 0;
    while k < log.bins.len() {
        let still =
            |b: usize| log.bins[b].idle_s > 0.3 && log.bins[b].t_s < log.bins[k].t_s + POOLED_S;
        let mut to = k + 1;
        while to < log.bins.len() && still(k) && still(to) {
            to += 1;
        }
        let n = ((to - k) as f64).sqrt();
        for q in log.quantities() {
            for axis in 0..3 {
                let weighted = |b: usize| residual[q][b][axis] * log.bins[b].weight[q];
                out.push((k..to).map(weighted).sum::<f64>() / n);
            }
        }
        k = to;
    }
    out
}

/// Removes from every column what a recalibration imitates (Schur complement).
fn clear_of_nominal(gram: DMatrix<f64>) -> DMatrix<f64> {
    let n = NOMINAL;
    let head = gram.view((0, 0), (n, n)) + DMatrix::identity(n, n) * 1e-6;
    let across = gram.view((0, 0), (n, gram.ncols())).into_owned();
    match head.cholesky() {
        Some(c) => &gram - across.tr_mul(&c.solve(&across)),
        None => gram,
    }
}

impl Information {
    /// Size of every point of every effect after a recalibration, standard deviations.
    pub fn sizes(&self) -> Vec<Vec<f64>> {
        let size = |c: usize| self.gram[(c, c)].max(0.0).sqrt();
        let of = |s: &Span| s.points.clone().map(size).collect();
        self.spans.iter().map(of).collect()
    }

    /// Distances between effects, in standard deviations, with each point scaled by `scale`. At `(i, j)` is the smaller of what remains of
    /// effect i after imitation by j and of j after imitation by i, and on the diagonal what remains after a recalibration.
    pub fn distances(&self, scale: &[Vec<f64>]) -> DMatrix<f64> {
        let n = self.spans.len();
        let mut of = DMatrix::from_element(n, n, f64::INFINITY);
        for j in 0..n {
            let left_by = self.imitated(&self.spans[j]);
            for i in 0..n {
                for (c, size) in self.spans[i].points.clone().zip(&scale[i]) {
                    let left = if i == j {
                        self.gram[(c, c)]
                    } else {
                        left_by(c)
                    };
                    let d = size * left.max(0.0).sqrt();
                    of[(i, j)] = of[(i, j)].min(d);
                    of[(j, i)] = of[(j, i)].min(d);
                }
            }
        }
        of
    }

    /// The square of what imitation by an effect leaves of a column.
    fn imitated(&self, span: &Span) -> impl Fn(usize) -> f64 {
        let columns = span.slopes.start..span.points.end;
        let (from, n) = (columns.start, columns.len());
        let own = self.gram.view((from, from), (n, n));
        let solved = (own + DMatrix::identity(n, n) * PRIOR).cholesky();
        move |c| {
            let across = self.gram.column(c).rows(from, n).into_owned();
            let solved = solved.as_ref().map(|s| s.solve(&across));
            self.gram[(c, c)] - solved.map_or(0.0, |solved| across.dot(&solved))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::catalogue;
    use rand::SeedableRng;

    #[test]
    fn draws_are_within_the_limits_and_away_from_zero_effect() {
        let mut rng = StdRng::seed_from_u64(5);
        for e in catalogue() {
            let params = e.params();
            let r = Rival::new(*e, None, &mut rng);
            assert_eq!(r.points.len(), DRAWS);
            for point in &r.points {
                assert!(
                    point
                        .iter()
                        .zip(params)
                        .all(|(v, p)| (p.low..=p.high).contains(v)),
                    "{}",
                    r.effect.name()
                );
                assert!(
                    point
                        .iter()
                        .zip(params)
                        .any(|(v, p)| (v - p.start).abs() > 0.2 * p.scale),
                    "{}",
                    r.effect.name()
                );
            }
        }
    }
}
