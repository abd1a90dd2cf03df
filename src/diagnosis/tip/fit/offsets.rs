//! What the offsets of an event change in the residuals of a log.

use crate::diagnosis::tip::fit::LeastSquares;
use crate::diagnosis::tip::observed::Segment;
use crate::model::Event;
use crate::model::effects::Effect;

/// Time to which an event is moved so that its offsets act on the whole log, s after the start: within the rest.
pub const EARLY_S: f64 = 1.5;
/// Duration of the events that a scan looks for, s; slower events have starting points of their own.
pub const SCANNED_S: f64 = 0.5;

/// Parameters at which an effect vanishes.
pub fn vanishing(effect: &dyn Effect) -> Vec<f64> {
    effect.params().iter().map(|p| p.start).collect()
}

/// What one unit of each offset of an event changes in the residuals `r0` of a segment from the rest on.
pub fn changes(
    problem: &LeastSquares<'_>,
    without: &[f64],
    event: &Event,
    segment: &Segment,
    r0: &[f64],
) -> [Vec<f64>; 3] {
    event.offsets.map(|o| {
        let (mut moved, scale) = (without.to_vec(), problem.bounds[o].scale);
        moved[event.time] = segment.start_s - problem.log.start_s() + EARLY_S;
        moved[o] = scale;
        let with = problem.residual_from_rest(&moved, EARLY_S);
        with.iter().zip(r0).map(|(x, y)| (x - y) / scale).collect()
    })
}
