//! Outside the catalogue: the syringe's rubber plunger sticks and jumps.
//!
//! Static friction holds the plunger until the rod has strained by the breakaway distance; the plunger then
//! jumps to where sliding friction holds it. Adhesion grows with the time at standstill: the breakaway
//! distance rises by `ageing` for every e-fold of seconds.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.stick_slip]`
    StickSlip at "effects.outside.stick_slip" sized by breakaway_mm; drawn by rng, severity {
        /// Rod strain at which a plunger breaks away, mm. Default 0 (none); plausible 0.1 to 0.8. A larger value
        /// moves in bigger jumps.
        breakaway_mm: f64 = 0.0, 0.0..=5.0, "tenths of a mm are plausible", draw rng.sized(0.3, 1.5, severity);
        /// Share of the breakaway strain that is left after the jump, 0 to 1. Default 0.3. A larger value jumps
        /// less.
        sliding: f64 = 0.3, 0.0..=1.0, "a share of the breakaway", draw rng.between(0.0, 0.4);
        /// How much breakaway rises with ln(1 + seconds at standstill). Default 0.1. A larger value ages faster.
        ageing: f64 = 0.1, 0.0..=2.0, "0.1 is plausible";
    }
    /// Three plungers with what they remember.
    Sticking runs config {
        plunger_mm: Vector3<f64> = Vector3::zeros();
        resting_s: Vector3<f64> = Vector3::zeros();
    }
}

impl Law for Sticking {
    fn rack(&mut self, rack_mm: &mut Vector3<f64>, at: &Moment) {
        let c = &self.config;
        for i in 0..3 {
            let strain = rack_mm[i] - self.plunger_mm[i];
            let holds = c.breakaway_mm * (1.0 + c.ageing * self.resting_s[i].ln_1p());
            if strain.abs() > holds {
                self.plunger_mm[i] = rack_mm[i] - strain.signum() * c.sliding * c.breakaway_mm;
                self.resting_s[i] = 0.0;
            } else {
                self.resting_s[i] += at.dt_s;
            }
        }
        *rack_mm = self.plunger_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plunger_moves_in_jumps() {
        let mut s = Sticking::new(StickSlip {
            breakaway_mm: 0.5,
            ..StickSlip::default()
        });
        let mut at = |rod_mm: f64| {
            let mut rack_mm = Vector3::repeat(rod_mm);
            s.rack(
                &mut rack_mm,
                &Moment {
                    t: 0.0,
                    dt_s: 0.001,
                },
            );
            rack_mm.x
        };
        let path: Vec<f64> = (0..=400).map(|k| at(0.01 * f64::from(k))).collect();
        let jumps: Vec<f64> = path
            .windows(2)
            .map(|w| w[1] - w[0])
            .filter(|d| *d != 0.0)
            .collect();
        assert!(
            (8..=14).contains(&jumps.len()) && jumps.iter().all(|j| (0.3..0.6).contains(j)),
            "{jumps:?}"
        );
    }
}
