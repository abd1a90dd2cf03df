//! A set of effects fitted to the log of a tip.

use crate::diagnosis::Scored;
use crate::diagnosis::tip::fit::{BaseFit, CLAIM_DEG, HeldOut, PRIOR_SLOPE, leave_out};
use crate::model::{Line, Model, lines};
use nalgebra::DMatrix;

/// A set of effects with its fit to the whole log and its scores.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Names, in catalogue order.
    pub names: Vec<&'static str>,
    /// The effects, and the places of their parameters.
    pub model: Model,
    /// Parameters: nominal, then effects.
    pub theta: Vec<f64>,
    /// Weighted sum of squares without the priors.
    pub cost: f64,
    /// Inverse of the normal matrix, for standard errors of white residuals.
    pub covariance: DMatrix<f64>,
    /// Information that the log gives about the parameters: half the logarithm of the determinant of the normal matrix over that of the
    /// priors alone (the Occam factor of Laplace's evidence, MacKay 1992).
    pub information: f64,
    /// Held-out scores.
    pub held_out: HeldOut,
    /// Sum over the effects of [`crate::model::effects::Effect::unusual`].
    pub unusual: f64,
}

impl Candidate {
    /// The candidate of a fit.
    pub fn new(fit: &BaseFit<'_>) -> Self {
        let (model, theta) = (&fit.problem.model, &fit.point.theta);
        let normal = fit.tangent.sums(&fit.problem, &fit.point).normal;
        let bounds = &fit.problem.bounds;
        let n = bounds.len();
        let inverse = normal.clone().try_inverse();
        let inverse = inverse.unwrap_or_else(|| DMatrix::identity(n, n));
        let scaled = |a: usize, b: usize| inverse[(a, b)] * bounds[a].scale * bounds[b].scale;
        let over_prior = |d: &f64| (d / PRIOR_SLOPE).ln();
        let roots = normal.cholesky().map(|c| c.l().diagonal());
        Self {
            names: model.names(),
            model: model.clone(),
            theta: theta.clone(),
            cost: fit.point.data(),
            covariance: DMatrix::from_fn(n, n, scaled),
            information: roots.map_or(0.0, |d| d.iter().map(over_prior).sum()),
            held_out: leave_out(fit),
            unusual: model.each(theta).map(|(e, p)| e.unusual(p)).sum(),
        }
    }

    /// Its gains.
    pub fn lines(&self) -> [Line; 3] {
        lines(&self.theta)
    }
}

impl Scored for Candidate {
    fn names(&self) -> &[&'static str] {
        &self.names
    }
    /// Held-out energy, deg².
    fn energy(&self) -> f64 {
        self.held_out.energy()
    }
    fn gain(&self, beyond: &Self) -> f64 {
        beyond.held_out.gain(&self.held_out) / CLAIM_DEG
    }
}
