//! A line that loses the air it holds.
//!
//! `ṁ = C x s(p)`, `x` the displacement still held (mm of piston). Flow through a pinhole is laminar at small
//! pressure and grows with the root of large pressure, `s = 2 / (1 + √(1 + |p|/p_t))`; a lip that vacuum sucks
//! shut leaks less. The step is exact for a flow coefficient held over the step.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.leak]`
    Leak at "effects.leak" sized by rate_per_s {
        /// Share of the held displacement that each line loses per second while pressure is small, 1/s.
        /// Default 0 (none); typical 1e-5 to 0.1. A larger value decays faster in holds.
        rate_per_s: [f64; 3] = [0.0; 3], "", 0.0..=1000.0, "0.1 empties a line within half a minute";
        /// Pressure p_t at which the flow turns turbulent, kPa. Default 8. A larger value stays closer to
        /// proportional.
        turbulent_kpa: f64 = 8.0, "", 0.1..=1e9, "8 is a pinhole";
        /// Leak under vacuum as a share of the leak under pressure. Default 0.6. A larger value leaks more alike.
        vacuum: f64 = 0.6, "", 0.0..=2.0, "1 leaks alike both ways";
    }
}

impl PlantEffect for Leak {
    const BACKGROUND: f64 = 5e-5;
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let rate = rng.sized(2e-3, 6e-2, severity);
        Self {
            rate_per_s: rng.on_channels(rate),
            vacuum: rng.between(0.4, 1.0),
            ..Self::default()
        }
    }
}

impl Leak {
    /// No holes yet; what they leak is proportional to pressure and the same under vacuum.
    pub(crate) const CLOSED: Self = Self {
        rate_per_s: [0.0; 3],
        turbulent_kpa: 1e6,
        vacuum: 1.0,
    };
}

/// Three lines that leak, with what they lost so far.
#[derive(Debug, Clone)]
pub(crate) struct Leaking {
    pub(crate) config: Leak,
    lost_mm: Vector3<f64>,
}

impl Leaking {
    pub(crate) fn new(config: Leak) -> Self {
        Self {
            config,
            lost_mm: Vector3::zeros(),
        }
    }
    /// What has leaked by the end of `dt_s`, mm of piston.
    pub(crate) fn step(
        &mut self,
        pushed_mm: &Vector3<f64>,
        pressure_kpa: &Vector3<f64>,
        dt_s: f64,
    ) -> Vector3<f64> {
        for i in 0..3 {
            if self.config.rate_per_s[i] > 0.0 {
                let x = self.config.rate_per_s[i] * self.opening(pressure_kpa[i]) * dt_s;
                // 1 − e^(−x), for slow leaks by its first terms (error below x³)
                let share = if x < 1e-4 {
                    x * (1.0 - 0.5 * x)
                } else {
                    -(-x).exp_m1()
                };
                self.lost_mm[i] += (pushed_mm[i] - self.lost_mm[i]) * share;
            }
        }
        self.lost_mm
    }
    fn opening(&self, pressure_kpa: f64) -> f64 {
        let side = if pressure_kpa < 0.0 {
            self.config.vacuum
        } else {
            1.0
        };
        side * 2.0 / (1.0 + (1.0 + pressure_kpa.abs() / self.config.turbulent_kpa).sqrt())
    }
}

impl Law for Leaking {
    fn air(&mut self, air_mm: &mut Vector3<f64>, bellows: &BellowState, at: &Moment) {
        *air_mm -= self.step(air_mm, &bellows.pressure_kpa, at.dt_s);
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
        let held = Vector3::repeat(10.0);
        let kpa = Vector3::repeat(1.0);
        let lost: Vec<f64> = (0..20_000).map(|_| l.step(&held, &kpa, 0.001).x).collect();
        assert!(lost.windows(2).all(|w| w[1] > w[0]));
        let left = (10.0 - lost[19_999]) / 10.0;
        assert!((left.ln() / 20.0 + 0.05).abs() < 0.003, "{left}");
        assert_eq!(l.lost_mm.y, 0.0);
        assert!(
            (l.step(&Vector3::zeros(), &Vector3::zeros(), 0.001).x - lost[19_999]).abs() < 0.01
        );
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
