//! Parameter values at which each effect is evaluated: draws from its prior, or the values of a saved model.
//!
//! Distances between effects grow with their sizes. The draws determine the direction only; the design gives all effects
//! the same size, so that a wide prior does not make an effect look easy to find.

use crate::diagnosis::tip::SavedModel;
use crate::model::effects::{Effect, Param};
use rand::RngExt;
use rand::rngs::StdRng;

/// Draws per effect.
const DRAWS: usize = 2;
/// A time with a wider prior than this is that of an event and is drawn within the log, s.
const EVENT_SIGMA_S: f64 = 50.0;
/// Events of an effect that a schedule is judged by. More would imitate everything.
const EVENTS_MAX: usize = 2;
/// Range of the times of events, s.
const EVENTS_S: (f64, f64) = (20.0, 150.0);

/// An effect with the points at which it is evaluated; slopes are taken at the first.
pub struct Rival {
    /// The effect.
    pub effect: Box<dyn Effect>,
    /// Parameter vectors.
    pub points: Vec<Vec<f64>>,
}

impl Rival {
    /// An effect at draws from its prior; events after the second do not happen.
    pub fn drawn(effect: Box<dyn Effect>, rng: &mut StdRng) -> Self {
        let (params, counted) = (effect.params(), counted(effect.as_ref()));
        let mut value = |(i, p): (usize, &Param)| if i < counted { draw(p, rng) } else { p.start };
        let mut point = || params.iter().enumerate().map(&mut value).collect();
        Self {
            points: (0..DRAWS).map(|_| point()).collect(),
            effect,
        }
    }

    /// An effect at the values of a saved model, or at draws if the model does not have it. The draws are taken in either
    /// case, so that they do not depend on the model.
    pub fn new(effect: Box<dyn Effect>, model: Option<&SavedModel>, rng: &mut StdRng) -> Self {
        let saved = model.and_then(|m| m.params_of(effect.as_ref()));
        let drawn = Self::drawn(effect, rng);
        Self {
            points: saved.map_or(drawn.points, |point| vec![point]),
            effect: drawn.effect,
        }
    }
}

/// Number of parameters by which a schedule is judged.
pub fn counted(effect: &dyn Effect) -> usize {
    let (all, events) = (effect.params().len(), effect.info().events);
    match events > EVENTS_MAX {
        true => all / events * EVENTS_MAX,
        false => all,
    }
}

/// A value 0.3 to 1.2 prior σ from the value without effect, on either side if the limits allow both.
fn draw(p: &Param, rng: &mut StdRng) -> f64 {
    if p.unit == "s" && p.scale > EVENT_SIGMA_S {
        return rng.random_range(EVENTS_S.0..EVENTS_S.1);
    }
    let two_sided = p.low < p.start - 0.1 * p.scale;
    let mirrored = two_sided && rng.random_bool(0.5);
    let sign = if mirrored { -1.0 } else { 1.0 };
    (p.start + sign * p.scale * rng.random_range(0.3..1.2)).clamp(p.low, p.high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::catalogue;
    use rand::SeedableRng;

    #[test]
    fn draws_are_within_the_limits_and_away_from_zero_effect() {
        let mut rng = StdRng::seed_from_u64(5);
        for e in catalogue() {
            let params = e.params();
            let r = Rival::drawn(e, &mut rng);
            assert_eq!(r.points.len(), DRAWS);
            for point in &r.points {
                assert!(
                    point
                        .iter()
                        .zip(params)
                        .all(|(v, p)| (p.low..=p.high).contains(v)),
                    "{}",
                    r.effect.name()
                );
                assert!(
                    point
                        .iter()
                        .zip(params)
                        .any(|(v, p)| (v - p.start).abs() > 0.2 * p.scale),
                    "{}",
                    r.effect.name()
                );
            }
        }
    }
}
