//! Play between rack and plunger, a true play operator, and its wear (outside the catalogue).
//!
//! The far end `w` is dragged when the near end has crossed the gap: `w ← clamp(w, u − λ, u + λ)`.
//! Teeth that wear widen it with the distance gone: `λ = λ₀ (1 + g (1 − e^(−s/S)))`.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// `[effects.outside.play_wear]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlayWear {
    /// Final growth g of the half-width, as a share of it. Default 0 (none); plausible 0.2 to 2.
    /// Bigger ends with more play.
    pub growth: f64,
    /// Travel S over which it wears, mm of piston. Default 300. Bigger wears more slowly.
    pub over_mm: f64,
}

impl Default for PlayWear {
    fn default() -> Self {
        Self { growth: 0.0, over_mm: 300.0 }
    }
}

impl PlantEffect for PlayWear {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.play_wear.growth", self.growth, -1.0..=10.0, "a share of the half-width")?;
        range("effects.outside.play_wear.over_mm", self.over_mm, 1.0..=1e6, "mm of piston travel")
    }
    fn size(&self) -> f64 {
        self.growth
    }
    fn scale(&mut self, factor: f64) {
        self.growth *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { growth: rng.sized(0.5, 2.5, severity), over_mm: rng.between(100.0, 400.0) }
    }
}

/// Three plays with what they remember.
#[derive(Debug, Clone)]
pub(crate) struct Play {
    half_width_mm: Vector3<f64>,
    wear: Option<PlayWear>,
    play_output_mm: Vector3<f64>,
    plunger_mm: Vector3<f64>,
    gone_mm: Vector3<f64>,
}

impl Play {
    pub(crate) fn new(half_width_mm: &[f64; 3], wear: Option<PlayWear>) -> Self {
        let zero = Vector3::zeros();
        Self { half_width_mm: Vector3::from(*half_width_mm), wear, play_output_mm: zero, plunger_mm: zero, gone_mm: zero }
    }
    pub(crate) fn play_output_mm(&self) -> Vector3<f64> {
        self.play_output_mm
    }
    pub(crate) fn step(&mut self, plunger_mm: &Vector3<f64>) -> Vector3<f64> {
        let width = self.worn_mm(plunger_mm);
        for i in 0..3 {
            self.play_output_mm[i] = self.play_output_mm[i].max(plunger_mm[i] - width[i]).min(plunger_mm[i] + width[i]);
        }
        self.play_output_mm
    }
    fn worn_mm(&mut self, plunger_mm: &Vector3<f64>) -> Vector3<f64> {
        let Some(wear) = &self.wear else { return self.half_width_mm };
        self.gone_mm += (plunger_mm - self.plunger_mm).abs();
        self.plunger_mm = *plunger_mm;
        Vector3::from_fn(|i, _| self.half_width_mm[i] * (1.0 - wear.growth * (-self.gone_mm[i] / wear.over_mm).exp_m1()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Width of the loop at rest of a 2 mm triangle, mm.
    fn gap(play: &mut Play) -> f64 {
        let mut at_zero = |to: f64| {
            play.step(&Vector3::repeat(to));
            play.step(&Vector3::zeros()).x
        };
        at_zero(2.0) - at_zero(-2.0)
    }

    #[test]
    fn a_loop_is_two_half_widths_and_grows_by_wear_only() {
        let mut whole = Play::new(&[0.5; 3], None);
        assert!((gap(&mut whole) - 1.0).abs() < 1e-12 && (gap(&mut whole) - 1.0).abs() < 1e-12);
        let mut worn = Play::new(&[0.5; 3], Some(PlayWear { growth: 1.0, over_mm: 20.0 }));
        let early = gap(&mut worn);
        for _ in 0..20 {
            gap(&mut worn);
        }
        assert!(gap(&mut worn) > early + 0.3 && gap(&mut worn) < 2.0 + 1e-9);
    }
}
