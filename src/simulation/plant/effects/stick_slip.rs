//! Outside the catalogue: the syringe's rubber plunger sticks and jumps.
//!
//! Static friction holds the plunger until the rod has strained by the breakaway distance; the plunger then
//! jumps to where sliding friction holds it. Adhesion grows with the time at standstill: the breakaway
//! distance rises by `ageing` for every e-fold of seconds.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.outside.stick_slip]`
    StickSlip at "effects.outside.stick_slip" sized by breakaway_mm {
        /// Rod strain at which a plunger breaks away, mm. Default 0 (none); plausible 0.1 to 0.8. A larger value
        /// moves in bigger jumps.
        breakaway_mm: f64 = 0.0, "", 0.0..=5.0, "tenths of a mm are plausible";
        /// Share of the breakaway strain that is left after the jump, 0 to 1. Default 0.3. A larger value jumps
        /// less.
        sliding: f64 = 0.3, "", 0.0..=1.0, "a share of the breakaway";
        /// How much breakaway rises with ln(1 + seconds at standstill). Default 0.1. A larger value ages faster.
        ageing: f64 = 0.1, "", 0.0..=2.0, "0.1 is plausible";
    }
}

impl PlantEffect for StickSlip {
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

impl Law for Sticking {
    fn rack(&mut self, rack_mm: &mut Vector3<f64>, at: &Moment) {
        *rack_mm = self.step(rack_mm, at.dt_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plunger_moves_in_jumps() {
        let mut s = Sticking::new(StickSlip { breakaway_mm: 0.5, ..StickSlip::default() });
        let path: Vec<f64> = (0..=400).map(|k| s.step(&Vector3::repeat(0.01 * f64::from(k)), 0.001).x).collect();
        let jumps: Vec<f64> = path.windows(2).map(|w| w[1] - w[0]).filter(|d| *d != 0.0).collect();
        assert!((8..=14).contains(&jumps.len()) && jumps.iter().all(|j| (0.3..0.6).contains(j)), "{jumps:?}");
    }
}
