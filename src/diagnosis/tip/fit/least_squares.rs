//! A model to be fitted to a log: priors, limits and the weighted residuals at a point of its parameter space.

use crate::diagnosis::tip::model::{LAG_MAX_S, Motion, Residuals, every_bin, run, sense};
use crate::diagnosis::tip::observed::{CORRELATED_S, Observed};
use crate::model::Model;
use crate::model::effects::Param;

/// Slope of the priors, residual per unit of scale. One prior σ is one scale for white residuals; neighbouring bins
/// are correlated, so a prior counts as much as four bins.
pub const PRIOR_SLOPE: f64 = 2.0;

/// A model, the log it is fitted to, and the bounds of its parameters.
#[derive(Clone)]
pub struct LeastSquares<'a> {
    /// The log.
    pub log: &'a Observed,
    /// The model.
    pub model: Model,
    /// Prior and limits of each parameter, nominal ones first.
    pub bounds: Vec<Param>,
}

/// A point of the parameter space with everything that follows from it.
#[derive(Debug, Clone)]
pub struct Point {
    /// Parameters.
    pub theta: Vec<f64>,
    /// Motion of the tip.
    pub motion: Motion,
    /// Weighted residuals: bin by bin, the logged quantities, three components each.
    pub residual: Vec<f64>,
    /// Sum of squares of the priors.
    pub prior: f64,
}

impl Point {
    /// Sum of squares including the priors.
    pub fn total(&self) -> f64 {
        self.data() + self.prior
    }

    /// Sum of squares of the data.
    pub fn data(&self) -> f64 {
        self.residual.iter().map(|r| r * r).sum()
    }
}

impl<'a> LeastSquares<'a> {
    /// The problem of fitting a model to a log.
    pub fn new(log: &'a Observed, model: Model) -> Self {
        let prior = log.rig.prior;
        let (k_epsilon, lag_s) = ((1.0 + prior.k_epsilon).ln(), log.rig.prior_lag_s);
        let mut bounds = vec![Param::new("ln(1 + k_epsilon)", "", k_epsilon, 0.3, (0.0, 2.0)); 3];
        bounds.extend([Param::new("k_lambda", "mm", prior.k_lambda_mm, 0.4, (0.0, 3.0)); 3]);
        bounds.push(Param::new("lag", "s", lag_s, 0.015, (0.002, LAG_MAX_S)));
        bounds.extend(model.effects.iter().flat_map(|e| e.params()));
        // one of several logs has the event
        for event in model.all_events() {
            bounds[event.time].scale *= log.segments.len() as f64;
        }
        Self { log, model, bounds }
    }

    /// Motion of the model at `theta`.
    pub fn motion(&self, theta: &[f64]) -> Motion {
        run(self.log, &self.model, theta)
    }

    /// Runs the model at `theta`.
    pub fn at(&self, theta: Vec<f64>) -> Point {
        let motion = self.motion(&theta);
        let residual = self.residual(&theta, &motion);
        let prior = self.prior(&theta);
        Point {
            theta,
            motion,
            residual,
            prior,
        }
    }

    /// Weighted residuals of a motion.
    pub fn residual(&self, theta: &[f64], motion: &Motion) -> Vec<f64> {
        let residual = sense(self.log, &self.model, theta, motion, every_bin);
        weighted(self.log, &residual)
    }

    /// Weighted residuals at `theta`; gravity, field and gyroscope bias of each log are solved on its rest, until `until_s` after its
    /// start.
    pub fn residual_from_rest(&self, theta: &[f64], until_s: f64) -> Vec<f64> {
        let log = self.log;
        let of = |k: usize| {
            let segment = log.segments.iter().rev().find(|s| s.bins.start <= k);
            segment.map_or((0, log.start_s()), |s| (s.bins.start, s.start_s))
        };
        let resting = |k: usize| of(k).0 == k || log.bins[k].t_s - of(k).1 < until_s;
        let residual = sense(log, &self.model, theta, &self.motion(theta), resting);
        weighted(log, &residual)
    }

    /// Sum of squares of the priors.
    pub fn prior(&self, theta: &[f64]) -> f64 {
        let away = |(t, b): (&f64, &Param)| (PRIOR_SLOPE * (t - b.start) / b.scale).powi(2);
        theta.iter().zip(&self.bounds).map(away).sum()
    }
}

/// Schwarz's criterion (1978) of a sum of squares: what a model with this many parameters more leaves, and what they cost.
pub fn schwarz(log: &Observed, squares: f64, params: usize) -> f64 {
    let independent = log.duration_s() / CORRELATED_S * 3.0 * log.quantities().count() as f64;
    independent * squares.ln() + params as f64 * independent.ln()
}

/// Parameters moved into their limits.
pub fn within(theta: impl IntoIterator<Item = f64>, bounds: &[Param]) -> Vec<f64> {
    let bounded = theta.into_iter().zip(bounds);
    bounded.map(|(t, b)| t.clamp(b.low, b.high)).collect()
}

/// Weighted residuals, bin by bin, the logged quantities, three components each.
pub fn weighted(log: &Observed, residual: &Residuals) -> Vec<f64> {
    let mut r = Vec::with_capacity(log.bins.len() * log.quantities().count() * 3);
    for (i, bin) in log.bins.iter().enumerate() {
        for q in log.quantities() {
            let v = residual[q][i] * bin.weight[q];
            r.extend([v.x, v.y, v.z]);
        }
    }
    r
}
