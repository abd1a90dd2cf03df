//! A bellow that resists elongation and contraction differently.
//!
//! Folds open one after another, so the stiffness turns over smoothly around rest:
//! `dW/dq = 1 + a x/√(1 + x²)` with `x = q/s`, hence `W = q + a s (√(1 + x²) − 1)`.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use serde::{Deserialize, Serialize};

/// `[effects.asymmetry]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Asymmetry {
    /// Half the difference of the two stiffnesses over their mean, a. Positive: elongation is
    /// stiffer. Default 0 (none); typical ±0.03 to 0.25 (5 to 40 % between the two sides). Bigger
    /// differs more.
    pub share: f64,
    /// Length change s over which one turns into the other, mm. Default 0.6. Bigger is smoother.
    pub knee_mm: f64,
}

impl Default for Asymmetry {
    fn default() -> Self {
        Self { share: 0.0, knee_mm: 0.6 }
    }
}

impl PlantEffect for Asymmetry {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.asymmetry.share", self.share, -0.8..=0.8, "±0.25 is a lot")?;
        range("effects.asymmetry.knee_mm", self.knee_mm, 0.01..=10.0, "0.6 is typical")
    }
    fn size(&self) -> f64 {
        self.share
    }
    fn scale(&mut self, factor: f64) {
        self.share = (self.share * factor).clamp(-0.8, 0.8);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { share: rng.sign() * rng.sized(0.08, 0.3, severity), knee_mm: rng.between(0.3, 1.2) }
    }
}

impl Asymmetry {
    /// Extra force over the mean stiffness, mm, and its slope.
    pub(crate) fn extra(&self, q_mm: f64) -> (f64, f64) {
        let x = q_mm / self.knee_mm;
        let root = (1.0 + x * x).sqrt();
        (self.share * self.knee_mm * (root - 1.0), self.share * x / root)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_side_is_stiffer_than_the_other() {
        let a = Asymmetry { share: 0.2, ..Asymmetry::default() };
        assert!((a.extra(5.0).1 - 0.2).abs() < 2e-3 && (a.extra(-5.0).1 + 0.2).abs() < 2e-3);
        assert!(a.extra(0.0).0.abs() < 1e-15 && a.extra(3.0).0 > 0.0 && a.extra(-3.0).0 > 0.0);
        for q in [-2.0, -0.1, 0.3, 4.0] {
            let numeric = (a.extra(q + 1e-6).0 - a.extra(q - 1e-6).0) / 2e-6;
            assert!((numeric - a.extra(q).1).abs() < 1e-6);
        }
    }
}
