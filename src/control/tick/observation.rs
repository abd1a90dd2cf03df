//! What one tick has measured and modelled.

use crate::estimation::fusion::tip::TipEstimate;
use crate::model::Bend;
use nalgebra::Vector2;

/// Measured and modelled bends of one tick, rad.
pub(super) struct Observation {
    pub(super) estimate: Option<TipEstimate>,
    pub(super) from_pistons: Bend,
    /// Bend that the reference model predicts for now.
    pub(super) predicted: Vector2<f64>,
    /// Rate of the predicted bend, rad/s.
    pub(super) predicted_rate: f64,
    /// Predicted minus estimated bend.
    pub(super) unexplained: Vector2<f64>,
    /// Bend at which the tip comes to rest if the pistons stop now: the estimate plus the motion that is still under way.
    pub(super) settled: Vector2<f64>,
}

impl Observation {
    pub(super) fn without_estimate(from_pistons: Bend) -> Self {
        let zero = Vector2::zeros();
        Self {
            estimate: None,
            from_pistons,
            predicted: zero,
            predicted_rate: 0.0,
            unexplained: zero,
            settled: zero,
        }
    }
}
