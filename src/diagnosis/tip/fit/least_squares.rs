//! A model to be fitted to a log: priors, limits and the weighted residuals at a point of its parameter space.

use crate::diagnosis::tip::model::{LAG_MAX_S, Model, Motion, Residuals, every_bin, run, sense};
use crate::diagnosis::tip::observed::Observed;
use crate::model::effects::Param;

/// Slope of the priors, residual per unit of scale. One prior σ is one scale for white residuals; neighbouring bins
/// are correlated, so a prior counts as much as four bins.
pub const PRIOR_SLOPE: f64 = 2.0;

/// Prior and limits of one parameter.
#[derive(Debug, Clone, Copy)]
pub struct Bound {
    /// Mean of the prior.
    pub start: f64,
    /// Unit step of the fit.
    pub scale: f64,
    /// Least value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

impl Bound {
    fn new(start: f64, scale: f64, low: f64, high: f64) -> Self {
        Self {
            start,
            scale,
            low,
            high,
        }
    }
}

/// A model, the log it is fitted to, and the bounds of its parameters.
#[derive(Clone)]
pub struct LeastSquares<'a> {
    /// The log.
    pub log: &'a Observed,
    /// The model.
    pub model: Model<'a>,
    /// One bound per parameter.
    pub bounds: Vec<Bound>,
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
    pub fn new(log: &'a Observed, model: Model<'a>) -> Self {
        let prior = log.rig.prior;
        let mut bounds = vec![Bound::new((1.0 + prior.k_epsilon).ln(), 0.3, 0.0, 2.0); 3];
        bounds.extend([Bound::new(prior.k_lambda_mm, 0.4, 0.0, 3.0); 3]);
        bounds.push(Bound::new(log.rig.prior_lag_s, 0.015, 0.002, LAG_MAX_S));
        for e in &model.effects {
            let of = |p: &Param| Bound::new(p.start, p.scale, p.low, p.high);
            bounds.extend(e.params().iter().map(of));
        }
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

    /// Residuals of a motion; gravity, field and gyroscope bias are solved on the bins that `mask` selects.
    pub fn sensed(
        &self,
        theta: &[f64],
        motion: &Motion,
        mask: impl Fn(usize) -> bool,
    ) -> Residuals {
        sense(self.log, &self.model, theta, motion, mask)
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

    /// Runs the model at `theta` moved into the limits.
    pub fn at_clamped(&self, theta: &[f64]) -> Point {
        let bounded = theta.iter().zip(&self.bounds);
        self.at(bounded.map(|(t, b)| t.clamp(b.low, b.high)).collect())
    }

    /// Weighted residuals of a motion.
    pub fn residual(&self, theta: &[f64], motion: &Motion) -> Vec<f64> {
        weighted(self.log, &self.sensed(theta, motion, every_bin))
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
        weighted(log, &self.sensed(theta, &self.motion(theta), resting))
    }

    /// Sum of squares of the priors.
    pub fn prior(&self, theta: &[f64]) -> f64 {
        let away = |(t, b): (&f64, &Bound)| (PRIOR_SLOPE * (t - b.start) / b.scale).powi(2);
        theta.iter().zip(&self.bounds).map(away).sum()
    }
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
