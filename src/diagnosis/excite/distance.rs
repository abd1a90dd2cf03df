//! Distances between the effects on a schedule.
//!
//! `D_ij² = min over θ_nominal, θ_j of ‖δ_i − J_0 Δθ_nominal − J_j Δθ_j‖²`, in standard deviations: the change that effect i
//! makes to the readings, less what a recalibration and effect j can imitate. It is the non-centrality of the test of
//! i against j, and 0 for effects that the schedule cannot separate. All distances follow from one Gram matrix of
//! weighted residual differences. Imitation is linearised about the points of each effect (slopes at the first point,
//! and the other points as directions).

use crate::diagnosis::excite::{Machine, Rival, ScheduleRow, counted, synthetic};
use crate::diagnosis::tip::model::{Model, residuals};
use crate::diagnosis::tip::observed::{CORRELATED_S, Observed};
use crate::model::{NOMINAL, nominal_theta};
use nalgebra::{DMatrix, DVector};
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

/// Columns of one effect in the Gram matrix, from and to.
struct Span {
    slopes: Range<usize>,
    points: Range<usize>,
}

/// What a schedule reveals about each effect.
pub struct Information {
    gram: DMatrix<f64>,
    spans: Vec<Span>,
    /// Length of the schedule, s.
    pub duration_s: f64,
}

/// Runs every rival over a schedule; `None` if the schedule is too short or moves too little to be diagnosed.
pub fn information(
    machine: &Machine,
    rows: &[ScheduleRow],
    rivals: &[Rival],
    tracker: bool,
    seed: u64,
) -> Option<Information> {
    let driven = machine.drive(rows, synthetic::PERIOD_S);
    let log = synthetic::observed(machine, &driven, tracker, seed).ok()?;
    let start = nominal_theta(&machine.lines, machine.rig.prior_lag_s);
    let none = Model::new(&[]);
    let base = residual(&log, &none, &start);
    let slope = |i: usize| {
        let mut theta = start.clone();
        theta[i] += NOMINAL_SCALE[i / 3] * STEP;
        difference(&residual(&log, &none, &theta), &base, STEP)
    };
    let mut columns: Vec<Vec<f64>> = (0..NOMINAL).map(slope).collect();
    let each = rivals
        .par_iter()
        .map(|r| columns_of(&log, r, &start, &base));
    let each: Vec<Vec<Vec<f64>>> = each.collect();
    let mut spans = Vec::new();
    for (rival, own) in rivals.iter().zip(each) {
        let (first, slopes) = (columns.len(), counted(rival.effect.as_ref()));
        spans.push(Span {
            slopes: first..first + slopes,
            points: first + slopes..first + own.len(),
        });
        columns.extend(own);
    }
    let matrix = DMatrix::from_iterator(base.len(), columns.len(), columns.into_iter().flatten());
    // a plain product is blocked for the cache, `tr_mul` is not
    let gram = matrix.transpose() * &matrix * (synthetic::PERIOD_S / CORRELATED_S);
    Some(Information {
        gram: clear_of_nominal(gram),
        spans,
        duration_s: driven.duration_s,
    })
}

fn difference(to: &[f64], from: &[f64], by: f64) -> Vec<f64> {
    to.iter().zip(from).map(|(a, b)| (a - b) / by).collect()
}

/// Slopes at the first point in units of scale, then the change that each point makes.
fn columns_of(log: &Observed, rival: &Rival, start: &[f64], base: &[f64]) -> Vec<Vec<f64>> {
    let model = Model::new(&[rival.effect.as_ref()]);
    let at = |point: &[f64]| residual(log, &model, &[start, point].concat());
    let here = at(&rival.points[0]);
    let mut out = Vec::new();
    let counted = counted(rival.effect.as_ref());
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
fn residual(log: &Observed, model: &Model<'_>, theta: &[f64]) -> Vec<f64> {
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

/// Distances between effects, in standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct Distances {
    /// `of[(i, j)]`: the smaller of what remains of effect i after imitation by j and of j after imitation by i; on the
    /// diagonal what remains after a recalibration.
    pub of: DMatrix<f64>,
    /// Length of the schedule, s.
    pub duration_s: f64,
}

impl Information {
    /// Size of every point of every effect after a recalibration, standard deviations.
    pub fn sizes(&self) -> Vec<Vec<f64>> {
        let size = |c: usize| self.gram[(c, c)].max(0.0).sqrt();
        let of = |s: &Span| s.points.clone().map(size).collect();
        self.spans.iter().map(of).collect()
    }

    /// Distances with each point scaled by `scale`.
    pub fn distances(&self, scale: &[Vec<f64>]) -> Distances {
        let n = self.spans.len();
        let mut of = DMatrix::from_element(n, n, f64::INFINITY);
        for j in 0..n {
            let imitate = Imitation::new(self, &self.spans[j]);
            for i in 0..n {
                for (c, size) in self.spans[i].points.clone().zip(&scale[i]) {
                    let left = match i == j {
                        true => self.gram[(c, c)],
                        false => imitate.left(self, c),
                    };
                    let d = size * left.max(0.0).sqrt();
                    of[(i, j)] = of[(i, j)].min(d);
                    of[(j, i)] = of[(j, i)].min(d);
                }
            }
        }
        Distances {
            of,
            duration_s: self.duration_s,
        }
    }
}

/// The directions in which an effect can imitate others.
struct Imitation {
    columns: Vec<usize>,
    solved: Option<nalgebra::Cholesky<f64, nalgebra::Dyn>>,
}

impl Imitation {
    fn new(info: &Information, span: &Span) -> Self {
        let columns: Vec<usize> = (span.slopes.start..span.points.end).collect();
        let n = columns.len();
        let gram = DMatrix::from_fn(n, n, |a, b| {
            info.gram[(columns[a], columns[b])] + if a == b { PRIOR } else { 0.0 }
        });
        Self {
            solved: gram.cholesky(),
            columns,
        }
    }

    /// Square of what imitation leaves of column `c`.
    fn left(&self, info: &Information, c: usize) -> f64 {
        let across = |k: usize, _| info.gram[(self.columns[k], c)];
        let across = DVector::from_fn(self.columns.len(), across);
        let solved = self.solved.as_ref();
        info.gram[(c, c)] - solved.map_or(0.0, |s| across.dot(&s.solve(&across)))
    }
}
