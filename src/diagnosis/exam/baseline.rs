//! Three answers that other methods would give from the same fits and the same tangents.
//!
//! * **BIC**: all sets that the search fitted, ranked in sample by `n ln(cost/n) + p ln n` with n the
//!   number of independent residuals (Schwarz 1978).
//! * **Sparse regression** (SINDy: Brunton, Proctor and Kutz, *PNAS* 2016): what the nominal model leaves
//!   is regressed on the tangents of all effects at once; groups whose part of the explained squares is
//!   below a threshold are struck out, and the rest is solved again.
//! * **Nearest signature**: the effect whose tangent makes the smallest angle with what is left.

use crate::diagnosis::begin::BaseFit;
use crate::diagnosis::chain::{Model, NOMINAL};
use crate::diagnosis::fit::{Point, bounds, fit_with_slope, nominal_start};
use crate::diagnosis::observe::Observed;
use crate::diagnosis::search::{Candidate, Found};
use crate::diagnosis::slope::Tangent;
use crate::model::effects::Effect;
use crate::model::transmission::Line;
use nalgebra::{DMatrix, DVector};

/// Residuals are correlated over about this long, s.
const CORRELATED_S: f64 = 1.0;
/// Part of the explained squares that a group must carry in the sparse regression.
const SPARSE: f64 = 0.12;
/// Part of the squares that anything must explain to be named, by regression and by signature.
const NAMED: f64 = 0.25;

/// Names that each method gives: BIC, sparse regression, nearest signature.
pub type Answers = [Vec<&'static str>; 3];

/// All three.
#[must_use]
pub fn answer(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3], found: &Found) -> Answers {
    let library = Library::new(log, catalogue, lines);
    [bic(log, found), library.sparse(), library.nearest()]
}

fn bic(log: &Observed, found: &Found) -> Vec<&'static str> {
    let n = log.duration_s() / CORRELATED_S * 3.0 * log.has.iter().filter(|&&h| h).count() as f64;
    let rows = log.bins.len() as f64 * n / (log.duration_s() / CORRELATED_S).max(1.0);
    let value = |c: &Candidate| n * (c.fitted.cost / rows).ln() + c.fitted.theta.len() as f64 * n.ln();
    let all = found.singles.iter().chain(&found.pairs).chain([&found.nominal]);
    all.min_by(|a, b| value(a).total_cmp(&value(b))).map_or(vec![], |c| c.names.clone())
}

/// Sums over the tangents of the whole catalogue at the nominal fit, the nominal parameters eliminated.
struct Library {
    names: Vec<&'static str>,
    /// First column of each effect and one past the last of all.
    at: Vec<usize>,
    normal: DMatrix<f64>,
    slope: DVector<f64>,
    total: f64,
}

impl Library {
    fn new(log: &Observed, catalogue: &[Box<dyn Effect>], lines: &[Line; 3]) -> Self {
        let (all, none) = (vec![1.0; log.bins.len()], Model::new(&[]));
        let (fitted, _) = fit_with_slope(log, &none, &nominal_start(lines), 6, false);
        let point = Point::new(log, &none, &bounds(&none), fitted.theta, &all);
        let tangent = Tangent::new(log, &none, &point, &bounds(&none), &all);
        let base_fit = BaseFit { model: none, point, tangent };
        let (mut columns, mut at) = (base_fit.tangent.clone(), vec![NOMINAL]);
        for e in catalogue {
            let model = Model::new(&[e.as_ref()]);
            let bounds = bounds(&model);
            let start: Vec<f64> = base_fit.point.theta.iter().copied().chain(e.starts().swap_remove(0)).collect();
            let here = Point::new(log, &model, &bounds, start, &all);
            columns.append(Tangent::grown(log, &model, &here, &bounds, &all, &base_fit), NOMINAL);
            at.push(columns.len());
        }
        let sums = columns.parts(&base_fit.point, log.bins.len(), 1, |_| Some(0)).swap_remove(0);
        let (n, k) = (columns.len(), NOMINAL);
        let ridge = DMatrix::identity(k, k) * 1e-6;
        let inverse = (sums.normal.view((0, 0), (k, k)) + ridge).try_inverse().unwrap_or_else(|| DMatrix::zeros(k, k));
        let across = sums.normal.view((k, 0), (n - k, k)).clone_owned();
        let normal = sums.normal.view((k, k), (n - k, n - k)) - &across * &inverse * across.transpose();
        let slope = sums.slope.rows(k, n - k) - &across * &inverse * sums.slope.rows(0, k);
        let at = at.iter().map(|a| a - NOMINAL).collect();
        Self { names: catalogue.iter().map(|e| e.name()).collect(), at, normal, slope, total: base_fit.point.data() }
    }

    /// Squares that these groups explain together.
    fn explained(&self, groups: &[usize]) -> f64 {
        let columns: Vec<usize> = groups.iter().flat_map(|&g| self.at[g]..self.at[g + 1]).collect();
        let n = columns.len();
        let normal = DMatrix::from_fn(n, n, |a, b| self.normal[(columns[a], columns[b])] + if a == b { 1.0 } else { 0.0 });
        let slope = DVector::from_fn(n, |a, _| self.slope[columns[a]]);
        normal.cholesky().map_or(0.0, |c| c.solve(&slope).dot(&slope))
    }

    fn sparse(&self) -> Vec<&'static str> {
        let mut kept: Vec<usize> = (0..self.names.len()).collect();
        loop {
            let whole = self.explained(&kept);
            if kept.is_empty() || whole < NAMED * self.total {
                return vec![];
            }
            let without = |g: usize| self.explained(&kept.iter().copied().filter(|&k| k != g).collect::<Vec<_>>());
            let worth: Vec<(usize, f64)> = kept.iter().map(|&g| (g, (whole - without(g)) / whole)).collect();
            match worth.iter().min_by(|a, b| a.1.total_cmp(&b.1)) {
                Some(&(g, share)) if share < SPARSE && kept.len() > 1 => kept.retain(|&k| k != g),
                _ => return kept.iter().map(|&k| self.names[k]).collect(),
            }
        }
    }

    fn nearest(&self) -> Vec<&'static str> {
        let of = |g: usize| self.explained(&[g]);
        let best = (0..self.names.len()).max_by(|&a, &b| of(a).total_cmp(&of(b)));
        best.filter(|&g| of(g) > NAMED * self.total).map_or(vec![], |g| vec![self.names[g]])
    }
}
