//! Outside the catalogue: a longer tip bends more easily than a short one.
//!
//! The bend is `1 + g (l − l₀)/5 mm` times what the bellows ask for.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use serde::{Deserialize, Serialize};

/// `[effects.outside.length_gain]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LengthGain {
    /// Change g of the bend for 5 mm of centre length. Default 0 (none); plausible ±0.1 to 0.5.
    /// Bigger couples more. At the resting length nothing is to be seen.
    pub share: f64,
}

/// Length change at which the share counts, mm.
const FULL_MM: f64 = 5.0;

impl PlantEffect for LengthGain {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.length_gain.share", self.share, -1.0..=1.0, "tenths are plausible")
    }
    fn size(&self) -> f64 {
        self.share
    }
    fn scale(&mut self, factor: f64) {
        self.share = (self.share * factor).clamp(-1.0, 1.0);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { share: rng.sign() * rng.sized(0.2, 0.7, severity) }
    }
}

impl LengthGain {
    /// Factor on the bend at a centre length that differs from rest by `longer_mm`.
    pub(crate) fn factor(&self, longer_mm: f64) -> f64 {
        (1.0 + self.share * longer_mm / FULL_MM).max(0.1)
    }
}
