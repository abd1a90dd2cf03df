//! Outside the catalogue: a longer tip bends more easily than a short one.
//!
//! The bend is `1 + g (l − l₀)/5 mm` times the bend that the bellow lengths give.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.length_gain]`
    LengthGain at "effects.outside.length_gain" sized by share; drawn by rng, severity {
        /// Change g of the bend for 5 mm of centre length. Default 0 (none); plausible ±0.1 to 0.5.
        /// A larger value couples more. At the resting length nothing is to be seen.
        share: f64 = 0.0, -1.0..=1.0, "tenths are plausible", draw rng.sign() * rng.sized(0.2, 0.7, severity);
    }
}

/// Length change at which the share counts, mm.
const FULL_MM: f64 = 5.0;

impl Law for LengthGain {
    fn bend(&mut self, bend: &mut Vector2<f64>, section: &SectionState) {
        *bend *= (1.0 + self.share * section.longer_mm / FULL_MM).max(0.1);
    }
}
