//! Tooth error of rack and pinion: periodic in the position of the rack, not in time.
//!
//! `e(u) = A (1 + v sin 0.37θ) sin(θ + s sin θ)`, `θ = 2πu/p + φ`: flanks wear on one side (skew `s`) and the
//! error varies from tooth to tooth (`v`). The error is relative to the start, so that `e(0) = 0`.

use crate::simulation::plant::prelude::*;
use std::f64::consts::{PI, TAU};

effect! {
    /// `[effects.gear_periodic]`
    GearPeriodic at "effects.gear_periodic" sized by amplitude_mm; background 0.01; drawn by rng, severity {
        /// Amplitude A of the rack's position error, mm. Default 0 (none); typical 0.02 to 0.3. A larger value
        /// ripples more.
        amplitude_mm: f64 = 0.0, 0.0..=2.0, "tenths of a mm at most are typical", draw rng.sized(0.04, 0.4, severity);
        /// Pitch p, mm of rack per tooth. Default π (module 1). A larger value gives a longer ripple.
        pitch_mm: f64 = PI, 0.1..=100.0, "π times the module";
        /// Where each pinion stands in its tooth at rest, degrees. Default [0, 120, 240].
        phase_deg: [f64; 3] = [0.0, 120.0, 240.0], -360.0..=360.0, "one tooth is 360°",
            draw [rng.angle_deg(), rng.angle_deg(), rng.angle_deg()];
        /// Skew s of the flank, 0 to 1. Default 0.4. A larger value is further from a sine.
        skew: f64 = 0.4, 0.0..=1.0, "beyond 1 the flank folds over", draw rng.between(0.1, 0.6);
        /// Variation v from tooth to tooth, 0 to 1. Default 0.2. A larger value repeats less exactly.
        variation: f64 = 0.2, 0.0..=1.0, "a share of the amplitude", draw rng.between(0.05, 0.3);
    }
    /// Racks with the tooth errors where they stand.
    Teeth runs config {
        rest_mm: Vector3<f64> = Vector3::from_fn(|i, _| config.wave(i, 0.0));
        rack_mm: Vector3<f64> = Vector3::zeros();
        error_mm: Vector3<f64> = Vector3::zeros();
    }
}

impl GearPeriodic {
    fn wave(&self, i: usize, rack_mm: f64) -> f64 {
        let theta = TAU * rack_mm / self.pitch_mm + self.phase_deg[i].to_radians();
        self.amplitude_mm
            * (1.0 + self.variation * (0.37 * theta).sin())
            * (theta + self.skew * theta.sin()).sin()
    }
}

impl Law for Teeth {
    fn rack(&mut self, rack_mm: &mut Vector3<f64>, _at: &Moment) {
        for i in 0..3 {
            // only racks that moved are worked out anew
            if rack_mm[i] != self.rack_mm[i] {
                self.error_mm[i] = self.config.wave(i, rack_mm[i]) - self.rest_mm[i];
            }
        }
        self.rack_mm = *rack_mm;
        *rack_mm += self.error_mm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_repeats_every_pitch_and_starts_at_zero() {
        let config = GearPeriodic {
            amplitude_mm: 0.2,
            variation: 0.0,
            ..GearPeriodic::default()
        };
        let mut g = Teeth::new(config.clone());
        let mut error_mm = |rack_mm: Vector3<f64>| {
            let mut off_mm = rack_mm;
            g.rack(&mut off_mm, &Moment { t: 0.0, dt_s: 0.0 });
            off_mm - rack_mm
        };
        assert!(error_mm(Vector3::zeros()).norm() < 1e-15);
        for k in 0..60 {
            let u = Vector3::repeat(0.1 * f64::from(k));
            assert!((error_mm(u) - error_mm(u.add_scalar(PI))).norm() < 1e-9);
        }
        // and is no plain sine: half a pitch on is not the mirror image
        let u = Vector3::repeat(0.4);
        assert!((config.wave(0, u.x) + config.wave(0, u.x + PI / 2.0)).abs() > 0.01);
    }
}
