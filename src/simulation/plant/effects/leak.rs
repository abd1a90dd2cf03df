//! A line that loses the air it holds.
//!
//! `ṁ = C x s(p)`, `x` the displacement still held (mm of piston). Flow through a pinhole is laminar at small
//! pressure and grows with the root of large pressure, `s = 2 / (1 + √(1 + |p|/p_t))`; a lip that vacuum sucks
//! shut leaks less. The step is exact for a flow coefficient held over the step.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.leak]`
    Leak at "effects.leak" sized by rate_per_s; background 5e-5; drawn by rng, severity {
        let rate = rng.sized(2e-3, 6e-2, severity);
        /// Share of the held displacement that each line loses per second while pressure is small, 1/s.
        /// Default 0 (none); typical 1e-5 to 0.1. A larger value decays faster in holds.
        rate_per_s: [f64; 3] = [0.0; 3], 0.0..=1000.0, "0.1 empties a line within half a minute", draw rng.on_channels(rate);
        /// Pressure p_t at which the flow turns turbulent, kPa. Default 8. A larger value stays closer to
        /// proportional.
        turbulent_kpa: f64 = 8.0, 0.1..=1e9, "8 is a pinhole";
        /// Leak under vacuum as a share of the leak under pressure. Default 0.6. A larger value leaks more alike.
        vacuum: f64 = 0.6, 0.0..=2.0, "1 leaks alike both ways", draw rng.between(0.4, 1.0);
    }
    /// Three lines that leak, with what they lost so far.
    Leaking runs config {
        lost_mm: Vector3<f64> = Vector3::zeros();
    }
}

impl Leaking {
    /// How far the flow is from proportional to pressure.
    fn opening(&self, pressure_kpa: f64) -> f64 {
        let vacuum = pressure_kpa < 0.0;
        let side = if vacuum { self.config.vacuum } else { 1.0 };
        side * 2.0 / (1.0 + (1.0 + pressure_kpa.abs() / self.config.turbulent_kpa).sqrt())
    }
}

impl Law for Leaking {
    fn air(&mut self, air_mm: &mut Vector3<f64>, bellows: &BellowState, at: &Moment) {
        for i in 0..3 {
            if self.config.rate_per_s[i] > 0.0 {
                let opening = self.opening(bellows.pressure_kpa[i]);
                let x = self.config.rate_per_s[i] * opening * at.dt_s;
                // 1 − e^(−x), for slow leaks by its first terms (error below x³)
                let share = if x < 1e-4 {
                    x * (1.0 - 0.5 * x)
                } else {
                    -(-x).exp_m1()
                };
                self.lost_mm[i] += (air_mm[i] - self.lost_mm[i]) * share;
            }
        }
        *air_mm -= self.lost_mm;
    }
    fn vent(&mut self) {
        self.lost_mm = Vector3::zeros();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hold_decays_and_leaves_an_offset() {
        let mut l = Leaking::new(Leak {
            rate_per_s: [0.05, 0.0, 0.0],
            ..Leak::default()
        });
        let mut leak = |held_mm: f64, kpa: f64| {
            let mut air_mm = Vector3::repeat(held_mm);
            let bellows = BellowState {
                pressure_kpa: Vector3::repeat(kpa),
                ..BellowState::default()
            };
            let at = Moment {
                t: 0.0,
                dt_s: 0.001,
            };
            l.air(&mut air_mm, &bellows, &at);
            Vector3::repeat(held_mm) - air_mm
        };
        let lost: Vec<f64> = (0..20_000).map(|_| leak(10.0, 1.0).x).collect();
        assert!(lost.windows(2).all(|w| w[1] > w[0]));
        let left = (10.0 - lost[19_999]) / 10.0;
        assert!((left.ln() / 20.0 + 0.05).abs() < 0.003, "{left}");
        let after = leak(0.0, 0.0);
        assert!(after.y == 0.0 && (after.x - lost[19_999]).abs() < 0.01);
    }

    #[test]
    fn a_leak_is_less_than_proportional_and_less_under_vacuum() {
        let l = Leaking::new(Leak {
            rate_per_s: [0.05; 3],
            ..Leak::default()
        });
        assert!(l.opening(20.0) < 0.75 * l.opening(0.1) && l.opening(-5.0) < l.opening(5.0));
    }
}
