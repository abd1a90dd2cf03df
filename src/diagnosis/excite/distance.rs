//! How far apart the effects lie on a schedule.
//!
//! `D_ij² = min over θ_nominal, θ_j of ‖δ_i − J_0 Δθ_nominal − J_j Δθ_j‖²`, in standard deviations: what
//! effect i changes in the sensors, less what a recalibration and effect j can imitate of it. It is
//! the non-centrality of the test of i against j, and 0 for effects that this schedule cannot
//! tell apart. Everything needed is in one Gram matrix of weighted differences of residuals;
//! imitation is linear about each effect's point (slopes, and the other points as directions).

use crate::diagnosis::chain::{Model, NOMINAL, run};
use crate::diagnosis::excite::points::Rival;
use crate::diagnosis::excite::rows::{Rig, Row};
use crate::diagnosis::excite::synthetic;
use crate::diagnosis::fit::nominal_start;
use crate::diagnosis::observe::Observed;
use crate::diagnosis::sense::sense;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Errors of the model are correlated over about this long, s: one observation counts per stretch.
const CORRELATED_S: f64 = 2.0;
/// Bins of a hold are taken together up to this long, s.
const TOGETHER_S: f64 = 0.5;
/// Finite-difference step as a fraction of a parameter's scale.
const STEP: f64 = 0.01;
/// Weight of a parameter's prior, 1/σ² in units of its scale.
const PRIOR: f64 = 1.0;

/// Columns of one effect in the Gram matrix.
#[derive(Debug, Clone, Copy)]
struct Span {
    slopes: (usize, usize),
    points: (usize, usize),
}

/// What a schedule tells of each effect.
pub struct Information {
    gram: DMatrix<f64>,
    spans: Vec<Span>,
    /// Bins taken together.
    pub rows: usize,
    /// Length of the schedule, s.
    pub duration_s: f64,
}

/// Runs every rival over a schedule; `None` if the schedule is too still or short to be diagnosed.
#[must_use]
pub fn information(rig: &Rig, rows: &[Row], rivals: &[Rival], tracker: bool, seed: u64) -> Option<Information> {
    let driven = rig.drive(rows, synthetic::PERIOD_S);
    let log = synthetic::observed(rig, &driven, tracker, seed).ok()?;
    let start = nominal_start(&rig.lines);
    let none = Model::new(&[]);
    let base = residual(&log, &none, &start);
    let away = |r: &[f64], by: f64| -> Vec<f64> { r.iter().zip(&base).map(|(a, b)| (a - b) / by).collect() };
    let mut columns: Vec<Vec<f64>> = (0..NOMINAL)
        .map(|i| {
            let h = [0.05, 0.1, 0.005][i / 3];
            let mut theta = start.clone();
            theta[i] += h * STEP;
            away(&residual(&log, &none, &theta), STEP)
        })
        .collect();
    let each: Vec<Vec<Vec<f64>>> = rivals.par_iter().map(|r| of_one(&log, r, &start, &base)).collect();
    let mut spans = Vec::new();
    for (rival, own) in rivals.iter().zip(each) {
        let (first, slopes) = (columns.len(), rival.effect.params().len());
        spans.push(Span { slopes: (first, first + slopes), points: (first + slopes, first + own.len()) });
        columns.extend(own);
    }
    let height = base.len();
    let matrix = DMatrix::from_iterator(height, columns.len(), columns.into_iter().flatten());
    // a product proper is blocked for the cache, `tr_mul` is not
    let gram = matrix.transpose() * &matrix * (synthetic::PERIOD_S / CORRELATED_S);
    Some(Information { gram: clear_of_nominal(gram), spans, rows: height, duration_s: driven.duration_s })
}

/// Slopes at the first point in units of scale, then the change that each point makes.
fn of_one(log: &Observed, rival: &Rival, start: &[f64], base: &[f64]) -> Vec<Vec<f64>> {
    let model = Model::new(&[rival.effect.as_ref()]);
    let at = |point: &[f64]| residual(log, &model, &[start, point].concat());
    let here = at(&rival.points[0]);
    let less = |r: Vec<f64>, from: &[f64], by: f64| -> Vec<f64> { r.iter().zip(from).map(|(a, b)| (a - b) / by).collect() };
    let mut out = Vec::new();
    for (i, p) in rival.effect.params().iter().enumerate() {
        let mut moved = rival.points[0].clone();
        let h = STEP * if moved[i] + STEP * p.scale > p.high { -1.0 } else { 1.0 };
        moved[i] += h * p.scale;
        out.push(less(at(&moved), &here, h));
    }
    out.push(less(here, base, 1.0));
    out.extend(rival.points[1..].iter().map(|p| less(at(p), base, 1.0)));
    out
}

/// Weighted residuals, the bins of a hold taken together.
fn residual(log: &Observed, model: &Model<'_>, theta: &[f64]) -> Vec<f64> {
    let all = vec![1.0; log.bins.len()];
    let s = sense(log, model, theta, &run(log, model, theta), &all);
    let kinds: Vec<usize> = (0..4).filter(|&k| log.has[k]).collect();
    let mut out = Vec::new();
    let mut k = 0;
    while k < log.bins.len() {
        let still = |b: usize| log.bins[b].idle_s > 0.3 && log.bins[b].t_s < log.bins[k].t_s + TOGETHER_S;
        let mut to = k + 1;
        while to < log.bins.len() && still(k) && still(to) {
            to += 1;
        }
        let n = ((to - k) as f64).sqrt();
        for &kind in &kinds {
            for axis in 0..3 {
                out.push((k..to).map(|b| s.residual[kind][b][axis] * log.bins[b].weight[kind]).sum::<f64>() / n);
            }
        }
        k = to;
    }
    out
}

/// Takes out of every column what a recalibration imitates (Schur complement).
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
    /// `of[(i, j)]`: what of effect i remains once effect j has imitated what it can, the smaller of
    /// both ways round; on the diagonal what remains after a recalibration.
    pub of: DMatrix<f64>,
    /// Length of the schedule, s.
    pub duration_s: f64,
}

impl Information {
    /// Size of every point of every effect as recalibration leaves it, standard deviations.
    #[must_use]
    pub fn sizes(&self) -> Vec<Vec<f64>> {
        let size = |c: usize| self.gram[(c, c)].max(0.0).sqrt();
        self.spans.iter().map(|s| (s.points.0..s.points.1).map(size).collect()).collect()
    }

    /// Distances with the points scaled by `scale`.
    #[must_use]
    pub fn distances(&self, scale: &[Vec<f64>]) -> Distances {
        let n = self.spans.len();
        let mut of = DMatrix::from_element(n, n, f64::INFINITY);
        for j in 0..n {
            let imitate = Imitation::new(self, self.spans[j]);
            for i in 0..n {
                let s = self.spans[i];
                for (c, size) in (s.points.0..s.points.1).zip(&scale[i]) {
                    let left = if i == j { self.gram[(c, c)] } else { imitate.left(self, c) };
                    let d = size * left.max(0.0).sqrt();
                    of[(i, j)] = of[(i, j)].min(d);
                    of[(j, i)] = of[(j, i)].min(d);
                }
            }
        }
        Distances { of, duration_s: self.duration_s }
    }
}

/// The directions that an effect can imitate others in.
struct Imitation {
    columns: Vec<usize>,
    solved: Option<nalgebra::Cholesky<f64, nalgebra::Dyn>>,
}

impl Imitation {
    fn new(info: &Information, span: Span) -> Self {
        let columns: Vec<usize> = (span.slopes.0..span.points.1).collect();
        let n = columns.len();
        let gram = DMatrix::from_fn(n, n, |a, b| info.gram[(columns[a], columns[b])] + if a == b { PRIOR } else { 0.0 });
        Self { solved: gram.cholesky(), columns }
    }
    /// Square of what is left of column `c`.
    fn left(&self, info: &Information, c: usize) -> f64 {
        let across = DVector::from_iterator(self.columns.len(), self.columns.iter().map(|&k| info.gram[(k, c)]));
        let taken = self.solved.as_ref().map_or(0.0, |s| across.dot(&s.solve(&across)));
        info.gram[(c, c)] - taken
    }
}
