//! Flow through the long thin lumen: laminar in the bore, turbulent at the ports.
//!
//! The strain across the line (mm of piston) drives the flow: `Δ = τ f + (τ o / 10) f |f|`, `f` in
//! mm/s and `o` the share of port loss at 10 mm/s. The flow for a strain is the root of that
//! quadratic; the step relaxes over the time constant `Δ/f` that the flow has at its start, which is
//! exact when `o = 0` and stable for every step.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.line_lag]`
    LineLag at "effects.line_lag" sized by lag_s; drawn by rng, severity {
        let tau = rng.sized(0.12, 0.9, severity);
        /// Time constant τ of each line for slow flow, s. Default 0 (none); typical 0.05 to 1. A larger value is
        /// slower.
        lag_s: [f64; 3] = [0.0; 3], 0.0..=20.0, "0.05 to 1 s is typical",
            draw std::array::from_fn(|_| tau * rng.between(0.85, 1.15));
        /// Port loss at 10 mm/s as a share of the bore's. Default 0.5. A larger value makes fast motion lag more
        /// than slow motion.
        port: f64 = 0.5, 0.0..=20.0, "a share of the loss in the bore", draw rng.between(0.2, 1.0);
    }
    /// Three lumens with what has passed them.
    Lumen runs config {
        passed_mm: Vector3<f64> = Vector3::zeros();
    }
}

impl Lumen {
    /// Δ / f for a strain Δ ≥ 0.
    fn tau_at(&self, i: usize, strain_mm: f64) -> f64 {
        let tau = self.config.lag_s[i];
        if tau <= 0.0 {
            return 0.0;
        }
        // f = 2 Δ / (τ + √(τ² + 4 b Δ)) with b = τ o / 10: the root without cancellation
        let b = tau * self.config.port / 10.0;
        0.5 * (tau + (tau * tau + 4.0 * b * strain_mm).sqrt())
    }
}

impl Law for Lumen {
    fn flow(&mut self, air_mm: &mut Vector3<f64>, at: &Moment) {
        for i in 0..3 {
            let strain = air_mm[i] - self.passed_mm[i];
            let tau = self.tau_at(i, strain.abs());
            self.passed_mm[i] += if tau > 0.0 {
                -strain * (-at.dt_s / tau).exp_m1()
            } else {
                strain
            };
        }
        *air_mm = self.passed_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What passes three lumens with `config` in each step, mm.
    fn flow(config: LineLag, pushed_mm: f64, dt_s: f64) -> impl Iterator<Item = Vector3<f64>> {
        let mut lumen = Lumen::new(config);
        std::iter::repeat_with(move || {
            let mut air_mm = Vector3::repeat(pushed_mm);
            lumen.flow(&mut air_mm, &Moment { t: 0.0, dt_s });
            air_mm
        })
    }

    /// Time to cover 63 % of a step of `size_mm`, s.
    fn rise(size_mm: f64) -> f64 {
        let mut passed = flow(
            LineLag {
                lag_s: [0.2; 3],
                port: 1.0,
            },
            size_mm,
            0.001,
        )
        .take(5000);
        (1 + passed.position(|z| z.x > 0.632 * size_mm).unwrap()) as f64 * 0.001
    }

    #[test]
    fn small_steps_take_tau_and_large_ones_longer() {
        assert!((rise(0.01) - 0.2).abs() < 0.01);
        assert!(rise(10.0) > 0.3);
    }

    #[test]
    fn the_flow_never_overshoots() {
        for z in flow(
            LineLag {
                lag_s: [0.05, 0.5, 0.0],
                port: 0.5,
            },
            3.0,
            0.01,
        )
        .take(100)
        {
            assert!(z.iter().all(|z| (0.0..=3.0).contains(z)));
        }
    }
}
