//! A set of effects fitted to the log of a tip.

use crate::diagnosis::Scored;
use crate::diagnosis::tip::fit::{BaseFit, CLAIM_DEG, Fitted, HeldOut, leave_out};

/// A set of effects with its fit and its scores.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Names, in catalogue order.
    pub names: Vec<&'static str>,
    /// Fit to the whole log.
    pub fitted: Fitted,
    /// Held-out scores.
    pub held_out: HeldOut,
    /// Sum over the effects of [`crate::model::effects::Effect::unusual`].
    pub unusual: f64,
}

impl Candidate {
    /// The candidate of a fit.
    pub fn new(fit: &BaseFit<'_>) -> Self {
        let (model, theta) = (&fit.problem.model, &fit.point.theta);
        Self {
            names: model.names(),
            fitted: Fitted::new(fit),
            held_out: leave_out(fit),
            unusual: model.each(theta).map(|(e, p)| e.unusual(p)).sum(),
        }
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
