//! Outside the catalogue: the syringe's rubber plunger sticks and jumps.
//!
//! The rod pushes on a plunger that holds by static friction: it stays until the rod has strained by
//! the breakaway distance, then jumps to where sliding friction holds it. Rubber that rests grows
//! fast: breakaway rises by a tenth for every e-fold of seconds at rest.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.outside.stick_slip]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StickSlip {
    /// Rod strain at which a plunger breaks away, mm. Default 0 (none); plausible 0.1 to 0.8. Bigger
    /// moves in bigger jumps.
    pub breakaway_mm: f64,
    /// Share of the breakaway strain that is left after the jump, 0 to 1. Default 0.3. Bigger jumps
    /// less.
    pub sliding: f64,
    /// How much breakaway rises with ln(1 + seconds at rest). Default 0.1. Bigger ages faster.
    pub ageing: f64,
}

impl Default for StickSlip {
    fn default() -> Self {
        Self { breakaway_mm: 0.0, sliding: 0.3, ageing: 0.1 }
    }
}

impl PlantEffect for StickSlip {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.stick_slip.breakaway_mm", self.breakaway_mm, 0.0..=5.0, "tenths of a mm are plausible")?;
        range("effects.outside.stick_slip.sliding", self.sliding, 0.0..=1.0, "a share of the breakaway")?;
        range("effects.outside.stick_slip.ageing", self.ageing, 0.0..=2.0, "0.1 is plausible")
    }
    fn size(&self) -> f64 {
        self.breakaway_mm
    }
    fn scale(&mut self, factor: f64) {
        self.breakaway_mm *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { breakaway_mm: rng.sized(0.3, 1.5, severity), sliding: rng.between(0.0, 0.4), ..Self::default() }
    }
}

/// Three plungers with what they remember.
#[derive(Debug, Clone)]
pub(crate) struct Sticking {
    config: StickSlip,
    plunger_mm: Vector3<f64>,
    resting_s: Vector3<f64>,
}

impl Sticking {
    pub(crate) fn new(config: StickSlip) -> Self {
        Self { config, plunger_mm: Vector3::zeros(), resting_s: Vector3::zeros() }
    }
    pub(crate) fn step(&mut self, rod_mm: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        for i in 0..3 {
            let strain = rod_mm[i] - self.plunger_mm[i];
            let holds = self.config.breakaway_mm * (1.0 + self.config.ageing * self.resting_s[i].ln_1p());
            if strain.abs() > holds {
                self.plunger_mm[i] = rod_mm[i] - strain.signum() * self.config.sliding * self.config.breakaway_mm;
                self.resting_s[i] = 0.0;
            } else {
                self.resting_s[i] += dt_s;
            }
        }
        self.plunger_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_in_jumps() {
        let mut s = Sticking::new(StickSlip { breakaway_mm: 0.5, ..StickSlip::default() });
        let path: Vec<f64> = (0..=400).map(|k| s.step(&Vector3::repeat(0.01 * f64::from(k)), 0.001).x).collect();
        let jumps: Vec<f64> = path.windows(2).map(|w| w[1] - w[0]).filter(|d| *d != 0.0).collect();
        assert!((8..=14).contains(&jumps.len()) && jumps.iter().all(|j| (0.3..0.6).contains(j)), "{jumps:?}");
    }
}
