//! Rubber that hardens with stretch exponentially: Fung's law for soft tissue and filled rubber.
//!
//! In addition to the linear wall, `h q (e^(|q|/s) − 1)`, with `h` such that the extra is `share` of the
//! linear force at 5 mm. The law is odd.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.stiffening]`
    Stiffening at "effects.stiffening" sized by share; background 0.003; drawn by rng, severity {
        /// Extra wall force at 5 mm of length change, as a share of the linear force. Default 0 (none);
        /// typical 0.05 to 0.5 (5 to 30 % of motion). A larger value bends less at large angles.
        share: f64 = 0.0, 0.0..=3.0, "0.05 to 0.5 is typical", draw rng.sized(0.12, 0.7, severity);
        /// Stretch s over which the extra grows by e, mm. Default 2.5. A larger value sets in earlier and more
        /// evenly.
        onset_mm: f64 = 2.5, 0.8..=50.0, "2.5 is typical; shorter is a wall, not rubber", draw rng.between(1.8, 4.0);
    }
    /// A wall that hardens.
    Hardening runs config {
        h: f64 = config.share / (FULL_MM / config.onset_mm).exp_m1();
    }
}

/// Stretch at which the share is counted, mm: a bellow's at 75° of bend, nearly.
const FULL_MM: f64 = 5.0;

impl Law for Hardening {
    fn wall(&self, q_mm: f64) -> Option<(f64, f64)> {
        let x = q_mm.abs() / self.config.onset_mm;
        let grown = x.exp() - 1.0;
        Some((self.h * q_mm * grown, self.h * (grown + x * (grown + 1.0))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extra_force_is_odd_and_stated_at_full_stretch() {
        let s = Hardening::new(Stiffening {
            share: 0.3,
            ..Stiffening::default()
        });
        let extra = |q_mm: f64| s.wall(q_mm).unwrap();
        assert!((extra(5.0).0 - 1.5).abs() < 1e-12 && extra(-5.0).0 == -extra(5.0).0);
        let gain = |q: f64| extra(q).0 / q;
        assert!(gain(1.0) < gain(2.0) && gain(2.0) < gain(4.0) && gain(1.0) < 0.03);
        for q in [-4.0, -0.3, 0.7, 5.5] {
            let numeric = (extra(q + 1e-6).0 - extra(q - 1e-6).0) / 2e-6;
            assert!((numeric - extra(q).1).abs() < 1e-6);
        }
    }
}
