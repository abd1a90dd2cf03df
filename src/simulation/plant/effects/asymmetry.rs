//! A bellow that resists elongation and contraction differently.
//!
//! Folds open one after another, so the stiffness changes smoothly around the rest length:
//! `dW/dq = 1 + a x/√(1 + x²)` with `x = q/s`, hence `W = q + a s (√(1 + x²) − 1)`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.asymmetry]`
    Asymmetry at "effects.asymmetry" sized by share; background 0.003; drawn by rng, severity {
        /// Half the difference of the two stiffnesses over their mean, a. Positive: elongation is
        /// stiffer. Default 0 (none); typical ±0.03 to 0.25 (5 to 40 % between the two sides). A larger value
        /// differs more.
        share: f64 = 0.0, -0.8..=0.8, "±0.25 is a lot", draw rng.sign() * rng.sized(0.08, 0.3, severity);
        /// Length change s over which one turns into the other, mm. Default 0.6. A larger value is smoother.
        knee_mm: f64 = 0.6, 0.01..=10.0, "0.6 is typical", draw rng.between(0.3, 1.2);
    }
}

impl Law for Asymmetry {
    fn wall(&self, q_mm: f64) -> Option<(f64, f64)> {
        let x = q_mm / self.knee_mm;
        let root = (1.0 + x * x).sqrt();
        let extra = self.share * self.knee_mm * (root - 1.0);
        Some((extra, self.share * x / root))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_side_is_stiffer_than_the_other() {
        let a = Asymmetry {
            share: 0.2,
            ..Asymmetry::default()
        };
        let extra = |q_mm: f64| a.wall(q_mm).unwrap();
        assert!((extra(5.0).1 - 0.2).abs() < 2e-3 && (extra(-5.0).1 + 0.2).abs() < 2e-3);
        assert!(extra(0.0).0.abs() < 1e-15 && extra(3.0).0 > 0.0 && extra(-3.0).0 > 0.0);
        for q in [-2.0, -0.1, 0.3, 4.0] {
            let numeric = (extra(q + 1e-6).0 - extra(q - 1e-6).0) / 2e-6;
            assert!((numeric - extra(q).1).abs() < 1e-6);
        }
    }
}
