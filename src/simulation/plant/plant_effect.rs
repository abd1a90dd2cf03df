//! What every imperfection of the plant has in common: a size, a range, a typical draw.

use crate::simulation::plant::check::PlantError;
use crate::simulation::plant::rng::PlantRng;

/// One physical cause beyond the nominal model.
pub(crate) trait PlantEffect: Clone {
    /// Refuses what the physics cannot run with.
    fn check(&self) -> Result<(), PlantError>;
    /// How much of it there is, in a unit of its own; 0 means that the plant is as without it.
    fn size(&self) -> f64;
    /// Makes it `factor` times as big.
    fn scale(&mut self, factor: f64);
    /// One of a plausible size: the small end of what is typical at severity 0, the big end at 1.
    fn draw(severity: f64, rng: &mut PlantRng) -> Self;
}

/// The cause if there is any of it, so that size 0 and absence are the same plant bit for bit.
pub(crate) fn active<C: PlantEffect>(cause: Option<&C>) -> Option<C> {
    cause.filter(|c| c.size() != 0.0).cloned()
}

/// Largest magnitude of several sizes.
pub(crate) fn largest(sizes: &[f64]) -> f64 {
    sizes.iter().fold(0.0, |a, s| a.max(s.abs()))
}

/// Scales several sizes.
pub(crate) fn scale_all(sizes: &mut [f64], factor: f64) {
    sizes.iter_mut().for_each(|s| *s *= factor);
}
