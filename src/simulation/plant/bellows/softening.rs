//! Rubber that its first stretches soften (Mullins), as damage by stored energy.
//!
//! The worst energy a wall has held, in the measure `m² = max(q² ...)` with contraction counting
//! `0.7 |q|`, breaks bonds: `D = 1 − d (1 − e^(−(m/s)²))`. Below the worst stretch so far nothing
//! changes any more (Simo 1987, with energy taken as quadratic).

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.softening]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Softening {
    /// Share d of the wall's stiffness that can be lost. Default 0 (none); typical 0.05 to 0.6.
    /// Bigger bends more after the first large stretch.
    pub share: f64,
    /// Stretch s at which 63 % of it is lost, mm. Default 3. Bigger needs larger stretches.
    pub stretch_mm: f64,
}

/// How much a contraction strains the wall compared with an elongation.
const CONTRACTION: f64 = 0.7;

impl Default for Softening {
    fn default() -> Self {
        Self { share: 0.0, stretch_mm: 3.0 }
    }
}

impl PlantEffect for Softening {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.softening.share", self.share, 0.0..=0.9, "a wall that loses all its stiffness is a burst")?;
        range("effects.softening.stretch_mm", self.stretch_mm, 0.1..=50.0, "a bellow stretches by 5 mm or so")
    }
    fn size(&self) -> f64 {
        self.share
    }
    fn scale(&mut self, factor: f64) {
        self.share = (self.share * factor).min(0.9);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { share: rng.sized(0.1, 0.5, severity), stretch_mm: rng.between(2.0, 4.0) }
    }
}

/// What each wall has been through.
#[derive(Debug, Clone)]
pub(crate) struct Damage {
    config: Softening,
    worst_mm: Vector3<f64>,
    left: Vector3<f64>,
}

impl Damage {
    pub(crate) fn new(config: Softening) -> Self {
        Self { config, worst_mm: Vector3::zeros(), left: Vector3::repeat(1.0) }
    }
    /// Share of each wall's stiffness that is left.
    pub(crate) fn left(&self) -> Vector3<f64> {
        self.left
    }
    /// The walls have been stretched to `bellow_mm`.
    pub(crate) fn stretch(&mut self, bellow_mm: &Vector3<f64>) {
        for i in 0..3 {
            let strain = bellow_mm[i].max(-CONTRACTION * bellow_mm[i]);
            if strain > self.worst_mm[i] {
                self.worst_mm[i] = strain;
                self.left[i] = 1.0 + self.config.share * (-(strain / self.config.stretch_mm).powi(2)).exp_m1();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_only_beyond_the_past_maximum() {
        let mut d = Damage::new(Softening { share: 0.4, ..Softening::default() });
        d.stretch(&Vector3::new(3.0, -3.0, 0.0));
        let once = d.left();
        assert!(once.x < 0.76 && once.y > once.x && once.y < 1.0 && once.z == 1.0);
        for q in [0.0, 2.9, -4.0, 3.0] {
            d.stretch(&Vector3::new(q, 0.0, 0.0));
        }
        assert_eq!(d.left().x, once.x);
        d.stretch(&Vector3::new(5.0, 0.0, 0.0));
        assert!(d.left().x < once.x && d.left().x > 0.6);
    }
}
