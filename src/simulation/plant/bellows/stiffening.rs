//! Rubber that hardens with stretch, exponentially: Fung's law for soft tissue and filled rubber.
//!
//! Beside the linear wall, `h q (e^(|q|/s) − 1)`, with `h` such that the extra is `share` of the
//! linear force at 5 mm. Odd, and with every odd and even power of |q| behind it.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use serde::{Deserialize, Serialize};

/// `[effects.stiffening]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Stiffening {
    /// Extra wall force at 5 mm of length change, as a share of the linear force. Default 0 (none);
    /// typical 0.05 to 0.5 (5 to 30 % of motion). Bigger bends less at large angles.
    pub share: f64,
    /// Stretch s over which the extra grows by e, mm. Default 2.5. Bigger sets in earlier and more
    /// evenly.
    pub onset_mm: f64,
}

/// Stretch at which the share is counted, mm: a bellow's at 75° of bend, nearly.
const FULL_MM: f64 = 5.0;

impl Default for Stiffening {
    fn default() -> Self {
        Self { share: 0.0, onset_mm: 2.5 }
    }
}

impl PlantEffect for Stiffening {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.stiffening.share", self.share, 0.0..=3.0, "0.05 to 0.5 is typical")?;
        range("effects.stiffening.onset_mm", self.onset_mm, 0.8..=50.0, "2.5 is typical; shorter is a wall, not rubber")
    }
    fn size(&self) -> f64 {
        self.share
    }
    fn scale(&mut self, factor: f64) {
        self.share *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { share: rng.sized(0.12, 0.7, severity), onset_mm: rng.between(1.8, 4.0) }
    }
}

/// A wall that hardens.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hardening {
    h: f64,
    onset_mm: f64,
}

impl Hardening {
    pub(crate) fn new(config: &Stiffening) -> Self {
        Self { h: config.share / (FULL_MM / config.onset_mm).exp_m1(), onset_mm: config.onset_mm }
    }
    /// Extra force over the linear stiffness, mm, and its slope.
    pub(crate) fn extra(&self, q_mm: f64) -> (f64, f64) {
        let x = q_mm.abs() / self.onset_mm;
        let grown = x.exp() - 1.0;
        (self.h * q_mm * grown, self.h * (grown + x * (grown + 1.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_odd_hardens_and_has_its_share_at_full_stretch() {
        let s = Hardening::new(&Stiffening { share: 0.3, ..Stiffening::default() });
        assert!((s.extra(5.0).0 - 1.5).abs() < 1e-12 && s.extra(-5.0).0 == -s.extra(5.0).0);
        let gain = |q: f64| s.extra(q).0 / q;
        assert!(gain(1.0) < gain(2.0) && gain(2.0) < gain(4.0) && gain(1.0) < 0.03);
        for q in [-4.0, -0.3, 0.7, 5.5] {
            let numeric = (s.extra(q + 1e-6).0 - s.extra(q - 1e-6).0) / 2e-6;
            assert!((numeric - s.extra(q).1).abs() < 1e-6);
        }
    }
}
