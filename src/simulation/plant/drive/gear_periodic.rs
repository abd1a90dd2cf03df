//! Tooth error of rack and pinion: periodic in where the rack stands, not in time.
//!
//! `e(u) = A (1 + v sin 0.37θ) sin(θ + s sin θ)`, `θ = 2πu/p + φ`: flanks wear on one side (skew `s`)
//! and no tooth is like the next (`v`). Counted from rest, so that `e(0) = 0`.

use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// `[effects.gear_periodic]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GearPeriodic {
    /// Amplitude A of the rack's position error, mm. Default 0 (none); typical 0.02 to 0.3. Bigger
    /// ripples more.
    pub amplitude_mm: f64,
    /// Pitch p, mm of rack per tooth. Default π (module 1). Bigger gives a longer ripple.
    pub pitch_mm: f64,
    /// Where each pinion stands in its tooth at rest, degrees. Default [0, 120, 240].
    pub phase_deg: [f64; 3],
    /// Skew s of the flank, 0 to 1. Default 0.4. Bigger is further from a sine.
    pub skew: f64,
    /// Variation v from tooth to tooth, 0 to 1. Default 0.2. Bigger repeats less exactly.
    pub variation: f64,
}

impl Default for GearPeriodic {
    fn default() -> Self {
        Self { amplitude_mm: 0.0, pitch_mm: PI, phase_deg: [0.0, 120.0, 240.0], skew: 0.4, variation: 0.2 }
    }
}

impl PlantEffect for GearPeriodic {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.gear_periodic.amplitude_mm", self.amplitude_mm, 0.0..=2.0, "tenths of a mm at most are typical")?;
        range("effects.gear_periodic.pitch_mm", self.pitch_mm, 0.1..=100.0, "π times the module")?;
        ranges("effects.gear_periodic.phase_deg", &self.phase_deg, -360.0..=360.0, "one tooth is 360°")?;
        range("effects.gear_periodic.skew", self.skew, 0.0..=1.0, "beyond 1 the flank folds over")?;
        range("effects.gear_periodic.variation", self.variation, 0.0..=1.0, "a share of the amplitude")
    }
    fn size(&self) -> f64 {
        self.amplitude_mm
    }
    fn scale(&mut self, factor: f64) {
        self.amplitude_mm *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            amplitude_mm: rng.sized(0.04, 0.4, severity),
            phase_deg: [rng.angle_deg(), rng.angle_deg(), rng.angle_deg()],
            skew: rng.between(0.1, 0.6),
            variation: rng.between(0.05, 0.3),
            ..Self::default()
        }
    }
}

/// Racks with the tooth errors where they stand.
#[derive(Debug, Clone)]
pub(crate) struct Teeth {
    config: GearPeriodic,
    rest_mm: Vector3<f64>,
    rack_mm: Vector3<f64>,
    error_mm: Vector3<f64>,
}

impl Teeth {
    pub(crate) fn new(config: GearPeriodic) -> Self {
        let rest_mm = Vector3::from_fn(|i, _| config.wave(i, 0.0));
        Self { config, rest_mm, rack_mm: Vector3::zeros(), error_mm: Vector3::zeros() }
    }
    /// Error of the three racks at their positions, mm; only racks that moved are worked out anew.
    pub(crate) fn error_mm(&mut self, rack_mm: &Vector3<f64>) -> Vector3<f64> {
        for i in 0..3 {
            if rack_mm[i] != self.rack_mm[i] {
                self.error_mm[i] = self.config.wave(i, rack_mm[i]) - self.rest_mm[i];
            }
        }
        self.rack_mm = *rack_mm;
        self.error_mm
    }
}

impl GearPeriodic {
    fn wave(&self, i: usize, rack_mm: f64) -> f64 {
        let theta = TAU * rack_mm / self.pitch_mm + self.phase_deg[i].to_radians();
        self.amplitude_mm * (1.0 + self.variation * (0.37 * theta).sin()) * (theta + self.skew * theta.sin()).sin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_every_pitch_and_is_zero_at_rest() {
        let config = GearPeriodic { amplitude_mm: 0.2, variation: 0.0, ..GearPeriodic::default() };
        let mut g = Teeth::new(config.clone());
        assert!(g.error_mm(&Vector3::zeros()).norm() < 1e-15);
        for k in 0..60 {
            let u = Vector3::repeat(0.1 * f64::from(k));
            assert!((g.error_mm(&u) - g.error_mm(&u.add_scalar(PI))).norm() < 1e-9);
        }
        // and is no plain sine: half a pitch on is not the mirror image
        let u = Vector3::repeat(0.4);
        assert!((config.wave(0, u.x) + config.wave(0, u.x + PI / 2.0)).abs() > 0.01);
    }
}
