//! Lumens of one catheter: one under pressure swells into its neighbours; one under vacuum does not.
//!
//! A line whose bellow is elongated by `q` displaces `c q²/(q + 0.8 mm)` worth of elongation in its
//! neighbours (soft at first, then proportional), more in the one that it lies nearer to.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.crosstalk]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Crosstalk {
    /// Elongation given to each neighbour per elongation, c. Default 0 (none); typical 0.01 to 0.3.
    /// Bigger bends less and lengthens more.
    pub share: f64,
    /// How much nearer a lumen lies to the next channel than to the one before, −1 to 1. Default
    /// 0.25. Bigger turns the bend more to one side.
    pub lopsided: f64,
}

impl Default for Crosstalk {
    fn default() -> Self {
        Self { share: 0.0, lopsided: 0.25 }
    }
}

/// Elongation at which squeezing has half its slope, mm.
const KNEE_MM: f64 = 0.8;

impl PlantEffect for Crosstalk {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.crosstalk.share", self.share, -0.4..=0.4, "more than that and the lines feed each other")?;
        range("effects.crosstalk.lopsided", self.lopsided, -1.0..=1.0, "1 reaches one neighbour only")
    }
    fn size(&self) -> f64 {
        self.share
    }
    fn scale(&mut self, factor: f64) {
        self.share *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { share: rng.sized(0.05, 0.3, severity), lopsided: rng.between(-0.6, 0.6) }
    }
}

impl Crosstalk {
    /// What is pressed into each line by the others, mm of piston: elongation times what a line needs
    /// for it.
    pub(crate) fn squeezed_mm(&self, bellow_mm: &Vector3<f64>, k_epsilon: &Vector3<f64>) -> Vector3<f64> {
        let swell = bellow_mm.map(|q| if q > 0.0 { self.share * q * q / (q + KNEE_MM) } else { 0.0 });
        Vector3::from_fn(|i, _| {
            let (before, after) = (swell[(i + 2) % 3], swell[(i + 1) % 3]);
            (before * (1.0 + self.lopsided) + after * (1.0 - self.lopsided)) * (1.0 + k_epsilon[i])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressure_moves_the_others_and_vacuum_does_not() {
        let c = Crosstalk { share: 0.1, lopsided: 0.0 };
        let k = Vector3::repeat(2.0);
        let pushed = c.squeezed_mm(&Vector3::new(5.0, 0.0, 0.0), &k);
        assert!(pushed.x == 0.0 && pushed.y > 1.0 && pushed.y == pushed.z);
        assert_eq!(c.squeezed_mm(&Vector3::new(-5.0, 0.0, 0.0), &k).norm(), 0.0);
        let lop = Crosstalk { lopsided: 1.0, ..c };
        assert_eq!(lop.squeezed_mm(&Vector3::new(5.0, 0.0, 0.0), &k).z, 0.0);
    }
}
