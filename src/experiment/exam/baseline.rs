//! Verdicts of three other methods, from the same fits and tangents.
//!
//! * **BIC**: all fitted sets, ranked in sample by `n ln(cost/n) + p ln n` with n the number of independent residuals
//!   (Schwarz 1978).
//! * **Sparse regression** (SINDy: Brunton, Proctor and Kutz, *PNAS* 2016): the nominal residual is regressed on the
//!   tangents of all effects at once; the effect with the smallest share of the explained squares is removed and the
//!   rest solved again until every share exceeds a threshold.
//! * **Nearest signature**: the effect whose tangent makes the smallest angle with the nominal residual.

use crate::diagnosis::Candidates;
use crate::diagnosis::tip::fit::{Candidate, LeastSquares, Tangent, fit};
use crate::diagnosis::tip::observed::Observed;
use crate::model::effects::catalogue;
use crate::model::{Line, Model, NOMINAL, nominal_theta};
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// Residuals are correlated over about this long, s.
const CORRELATED_S: f64 = 1.0;
/// Share of the explained squares that an effect must carry in the sparse regression.
const SPARSE: f64 = 0.12;
/// Share of the squares that must be explained for anything to be named, by regression and by signature.
const NAMED: f64 = 0.25;
/// Rounds of the nominal fit.
const ROUNDS: usize = 6;

/// Names given by the three methods.
#[derive(Debug, Clone, Serialize)]
pub struct Answers {
    /// By BIC.
    pub bic: Vec<&'static str>,
    /// By sparse regression.
    pub sparse: Vec<&'static str>,
    /// By the nearest signature.
    pub nearest: Vec<&'static str>,
}

/// The verdicts of all three methods.
pub fn answer(log: &Observed, lines: &[Line; 3], found: &Candidates<Candidate>) -> Answers {
    let library = Library::new(log, lines);
    Answers {
        bic: bic(log, found),
        sparse: library.sparse(),
        nearest: library.nearest(),
    }
}

fn bic(log: &Observed, found: &Candidates<Candidate>) -> Vec<&'static str> {
    let n = log.duration_s() / CORRELATED_S * 3.0 * log.quantities().count() as f64;
    let rows = log.bins.len() as f64 * n / (log.duration_s() / CORRELATED_S).max(1.0);
    let value = |c: &Candidate| n * (c.cost / rows).ln() + c.theta.len() as f64 * n.ln();
    let all = found.sets().chain([&found.nominal]);
    let least = all.min_by(|a, b| value(a).total_cmp(&value(b)));
    least.map_or(vec![], |c| c.names.clone())
}

/// Sums over the tangents of the whole catalogue at the nominal fit, with the nominal parameters eliminated.
struct Library {
    names: Vec<&'static str>,
    /// First column of each effect, and one past the last of all.
    at: Vec<usize>,
    normal: DMatrix<f64>,
    gradient: DVector<f64>,
    total: f64,
}

impl Library {
    fn new(log: &Observed, lines: &[Line; 3]) -> Self {
        let nominal = LeastSquares::new(log, Model::new(&[]));
        let mut base = fit(nominal, &nominal_theta(lines, log.rig.prior_lag_s), ROUNDS);
        base.tangent = Tangent::new(&base.problem, &base.point);
        let (mut all, mut at) = (base.tangent.clone(), vec![NOMINAL]);
        for e in catalogue() {
            let problem = LeastSquares::new(log, Model::new(&[*e]));
            let here = problem.at([base.point.theta.as_slice(), &e.starts()[0]].concat());
            let mut own = Tangent::grown(&problem, &here, &base).columns;
            all.columns.extend(own.drain(NOMINAL..));
            at.push(all.columns.len());
        }
        let sums = all.whole(&base.point, log.bins.len());
        let (n, k) = (all.columns.len(), NOMINAL);
        let ridge = DMatrix::identity(k, k) * 1e-6;
        let inverse = (sums.normal.view((0, 0), (k, k)) + ridge).try_inverse();
        let inverse = inverse.unwrap_or_else(|| DMatrix::zeros(k, k));
        let across = sums.normal.view((k, 0), (n - k, k)).clone_owned();
        let normal =
            sums.normal.view((k, k), (n - k, n - k)) - &across * &inverse * across.transpose();
        let gradient = sums.gradient.rows(k, n - k) - &across * &inverse * sums.gradient.rows(0, k);
        let at = at.iter().map(|a| a - NOMINAL).collect();
        Self {
            names: catalogue().iter().map(|e| e.name()).collect(),
            at,
            normal,
            gradient,
            total: base.point.data(),
        }
    }

    /// Squares that these effects explain together.
    fn explained(&self, effects: &[usize]) -> f64 {
        let columns = effects.iter().flat_map(|&g| self.at[g]..self.at[g + 1]);
        let columns: Vec<usize> = columns.collect();
        let n = columns.len();
        let normal = DMatrix::from_fn(n, n, |a, b| {
            self.normal[(columns[a], columns[b])] + if a == b { 1.0 } else { 0.0 }
        });
        let gradient = DVector::from_fn(n, |a, _| self.gradient[columns[a]]);
        let solved = normal.cholesky();
        solved.map_or(0.0, |c| c.solve(&gradient).dot(&gradient))
    }

    fn sparse(&self) -> Vec<&'static str> {
        let mut kept: Vec<usize> = (0..self.names.len()).collect();
        loop {
            let whole = self.explained(&kept);
            if kept.is_empty() || whole < NAMED * self.total {
                return vec![];
            }
            let without = |g: usize| {
                self.explained(&kept.iter().copied().filter(|&k| k != g).collect::<Vec<_>>())
            };
            let shares = kept.iter().map(|&g| (g, (whole - without(g)) / whole));
            match shares.min_by(|a, b| a.1.total_cmp(&b.1)) {
                Some((g, share)) if share < SPARSE && kept.len() > 1 => kept.retain(|&k| k != g),
                _ => return kept.iter().map(|&k| self.names[k]).collect(),
            }
        }
    }

    fn nearest(&self) -> Vec<&'static str> {
        let of = |g: usize| self.explained(&[g]);
        let best = (0..self.names.len()).max_by(|&a, &b| of(a).total_cmp(&of(b)));
        best.filter(|&g| of(g) > NAMED * self.total)
            .map_or(vec![], |g| vec![self.names[g]])
    }
}
