//! Where in its parameters each effect is looked at: draws from its prior, or the values of a model.
//!
//! Distances between effects depend on their sizes. Draws give the shape; sizes are set alike by
//! [`crate::diagnosis::excite::distance`], so that a generous prior does not look easy to find.

use crate::diagnosis::saved::SavedModel;
use crate::model::effects::{Effect, Param};
use rand::RngExt;
use rand::rngs::StdRng;

/// Draws per effect.
const DRAWS: usize = 2;
/// A time with a prior wider than this is a date: it is drawn within the log, s.
const DATE_SIGMA_S: f64 = 50.0;
/// Dates are drawn from here to there, s.
const DATES_S: (f64, f64) = (20.0, 150.0);

/// One effect with the points it is looked at; the first one is where slopes are taken.
pub struct Rival {
    /// The effect.
    pub effect: Box<dyn Effect>,
    /// Parameter vectors.
    pub points: Vec<Vec<f64>>,
}

impl Rival {
    /// The effect at draws from its prior.
    pub fn drawn(effect: Box<dyn Effect>, rng: &mut StdRng) -> Self {
        let params = effect.params();
        let points = (0..DRAWS).map(|_| params.iter().map(|p| draw(p, rng)).collect()).collect();
        Self { effect, points }
    }

    /// The effect as a saved model has it.
    #[must_use]
    pub fn saved(effect: Box<dyn Effect>, model: &SavedModel) -> Option<Self> {
        let point = model.params_of(effect.as_ref())?;
        Some(Self { effect, points: vec![point] })
    }
}

/// A value at a usual distance from where the effect does nothing, either side if it has two.
fn draw(p: &Param, rng: &mut StdRng) -> f64 {
    if p.unit == "s" && p.scale > DATE_SIGMA_S {
        return rng.random_range(DATES_S.0..DATES_S.1);
    }
    let two_sided = p.low < p.start - 0.1 * p.scale;
    let sign = if two_sided && rng.random_bool(0.5) { -1.0 } else { 1.0 };
    (p.start + sign * p.scale * rng.random_range(0.3..1.2)).clamp(p.low, p.high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::catalogue;
    use rand::SeedableRng;

    #[test]
    fn draws_are_physical_and_not_nothing() {
        let mut rng = StdRng::seed_from_u64(5);
        for e in catalogue() {
            let params = e.params();
            let r = Rival::drawn(e, &mut rng);
            assert_eq!(r.points.len(), DRAWS);
            for point in &r.points {
                assert!(point.iter().zip(params).all(|(v, p)| (p.low..=p.high).contains(v)), "{}", r.effect.name());
                assert!(point.iter().zip(params).any(|(v, p)| (v - p.start).abs() > 0.2 * p.scale), "{}", r.effect.name());
            }
        }
    }
}
