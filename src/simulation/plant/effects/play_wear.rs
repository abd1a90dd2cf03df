//! Outside the catalogue: play between rack and plunger that grows with use.
//!
//! Worn teeth widen the half-width with the distance travelled: `λ = λ₀ (1 + g (1 − e^(−s/S)))`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.play_wear]`
    PlayWear at "effects.outside.play_wear" sized by growth; drawn by rng, severity {
        /// Final growth g of the half-width, as a share of it. Default 0 (none); plausible 0.2 to 2.
        /// A larger value ends with more play.
        growth: f64 = 0.0, -1.0..=10.0, "a share of the half-width", draw rng.sized(0.5, 2.5, severity);
        /// Travel S over which it wears, mm of piston. Default 300. A larger value wears more slowly.
        over_mm: f64 = 300.0, 1.0..=1e6, "mm of piston travel", draw rng.between(100.0, 400.0);
    }
    /// Teeth with the distance that each has travelled.
    Wearing runs config {
        plunger_mm: Vector3<f64> = Vector3::zeros();
        gone_mm: Vector3<f64> = Vector3::zeros();
    }
}

impl Law for Wearing {
    fn play(&mut self, half_width_mm: &mut Vector3<f64>, plunger_mm: &Vector3<f64>) {
        self.gone_mm += (plunger_mm - self.plunger_mm).abs();
        self.plunger_mm = *plunger_mm;
        for i in 0..3 {
            let worn = -(-self.gone_mm[i] / self.config.over_mm).exp_m1();
            half_width_mm[i] *= 1.0 + self.config.growth * worn;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_half_width_grows_with_the_distance() {
        let mut worn = Wearing::new(PlayWear {
            growth: 1.0,
            over_mm: 20.0,
        });
        let mut width = |to: f64| {
            let mut half_width = Vector3::repeat(0.5);
            worn.play(&mut half_width, &Vector3::repeat(to));
            half_width.x
        };
        assert_eq!(width(0.0), 0.5);
        assert!((width(20.0) - 0.5 * (2.0 - (-1f64).exp())).abs() < 1e-12 && width(-500.0) > 0.999);
    }
}
