//! A line that loses the air it holds.
//!
//! `ṁ = C x s(p)`, `x` the displacement still held (mm of piston). Through a pinhole the flow is
//! laminar while pressure is small and grows with its root when it is large:
//! `s = 2 / (1 + √(1 + |p|/p_t))`; a lip that is sucked shut leaks less under vacuum. Stepped exactly
//! for a flow coefficient held over the step.

use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::plant_effect::{PlantEffect, largest, scale_all};
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.leak]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Leak {
    /// Share of the held displacement that each line loses per second while pressure is small, 1/s.
    /// Default 0 (none); typical 1e-5 to 0.1. Bigger decays faster in holds.
    pub rate_per_s: [f64; 3],
    /// Pressure p_t at which the flow turns turbulent, kPa. Default 8. Bigger stays closer to
    /// proportional.
    pub turbulent_kpa: f64,
    /// Leak under vacuum as a share of the leak under pressure. Default 0.6. Bigger leaks more alike.
    pub vacuum: f64,
}

impl Default for Leak {
    fn default() -> Self {
        Self { rate_per_s: [0.0; 3], turbulent_kpa: 8.0, vacuum: 0.6 }
    }
}

impl Leak {
    /// One that knows neither turbulence nor lips: a hole.
    pub(crate) fn plain(rate_per_s: [f64; 3]) -> Self {
        Self { rate_per_s, turbulent_kpa: 1e6, vacuum: 1.0 }
    }
}

impl PlantEffect for Leak {
    fn check(&self) -> Result<(), PlantError> {
        ranges("effects.leak.rate_per_s", &self.rate_per_s, 0.0..=1000.0, "0.1 empties a line within half a minute")?;
        range("effects.leak.turbulent_kpa", self.turbulent_kpa, 0.1..=1e9, "8 is a pinhole")?;
        range("effects.leak.vacuum", self.vacuum, 0.0..=2.0, "1 leaks alike both ways")
    }
    fn size(&self) -> f64 {
        largest(&self.rate_per_s)
    }
    fn scale(&mut self, factor: f64) {
        scale_all(&mut self.rate_per_s, factor);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let rate = rng.sized(2e-3, 6e-2, severity);
        Self { rate_per_s: rng.on_channels(rate), vacuum: rng.between(0.4, 1.0), ..Self::default() }
    }
}

/// Three lines that leak, with what they lost so far.
#[derive(Debug, Clone)]
pub(crate) struct Leaking {
    leak: Leak,
    lost_mm: Vector3<f64>,
}

impl Leaking {
    pub(crate) fn new(leak: Leak) -> Self {
        Self::with_lost(leak, Vector3::zeros())
    }
    pub(crate) fn with_lost(leak: Leak, lost_mm: Vector3<f64>) -> Self {
        Self { leak, lost_mm }
    }
    pub(crate) fn rate_per_s(&self) -> [f64; 3] {
        self.leak.rate_per_s
    }
    /// The line is opened with its piston at rest: what was lost flows back.
    pub(crate) fn vent(&mut self) {
        self.lost_mm = Vector3::zeros();
    }
    pub(crate) fn lost_mm(&self) -> Vector3<f64> {
        self.lost_mm
    }
    /// What has leaked by the end of `dt_s`, mm of piston.
    pub(crate) fn step(&mut self, pushed_mm: &Vector3<f64>, pressure_kpa: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        for i in 0..3 {
            if self.leak.rate_per_s[i] > 0.0 {
                let x = self.leak.rate_per_s[i] * self.opening(pressure_kpa[i]) * dt_s;
                // 1 − e^(−x), for slow leaks by its first terms (error below x³)
                let share = if x < 1e-4 { x * (1.0 - 0.5 * x) } else { -(-x).exp_m1() };
                self.lost_mm[i] += (pushed_mm[i] - self.lost_mm[i]) * share;
            }
        }
        self.lost_mm
    }
    fn opening(&self, pressure_kpa: f64) -> f64 {
        let side = if pressure_kpa < 0.0 { self.leak.vacuum } else { 1.0 };
        side * 2.0 / (1.0 + (1.0 + pressure_kpa.abs() / self.leak.turbulent_kpa).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decays_in_a_hold_and_leaves_an_offset_behind() {
        let mut l = Leaking::new(Leak { rate_per_s: [0.05, 0.0, 0.0], ..Leak::default() });
        let held = Vector3::repeat(10.0);
        let kpa = Vector3::repeat(1.0);
        let lost: Vec<f64> = (0..20_000).map(|_| l.step(&held, &kpa, 0.001).x).collect();
        assert!(lost.windows(2).all(|w| w[1] > w[0]));
        let left = (10.0 - lost[19_999]) / 10.0;
        assert!((left.ln() / 20.0 + 0.05).abs() < 0.003, "{left}");
        assert_eq!(l.lost_mm().y, 0.0);
        assert!((l.step(&Vector3::zeros(), &Vector3::zeros(), 0.001).x - lost[19_999]).abs() < 0.01);
    }

    #[test]
    fn is_less_than_proportional_and_less_under_vacuum() {
        let l = Leaking::new(Leak { rate_per_s: [0.05; 3], ..Leak::default() });
        assert!(l.opening(20.0) < 0.75 * l.opening(0.1) && l.opening(-5.0) < l.opening(5.0));
    }
}
