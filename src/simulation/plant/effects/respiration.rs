//! Outside the catalogue: the patient breathes, and the tissue pushes the tip to and fro.
//!
//! `A (0.8 sin φ + 0.2 sin 2φ)` along one direction of bend: in faster than out. There is no push during the first 3 s.

use crate::simulation::plant::prelude::*;
use std::f64::consts::TAU;

effect! {
    /// `[effects.outside.respiration]`
    Respiration at "effects.outside.respiration" sized by amplitude_deg; drawn by rng, severity {
        /// Amplitude A of the push, degrees of bend. Default 0 (none); plausible 1 to 5. A larger value pushes further.
        amplitude_deg: f64 = 0.0, 0.0..=30.0, "1 to 5 is plausible", draw rng.sized(1.0, 5.0, severity);
        /// Period of a breath, s. Default 4. A larger value pushes more slowly.
        period_s: f64 = 4.0, 0.5..=60.0, "3 to 5 s at rest", draw rng.between(3.0, 5.0);
        /// Direction of the push, degrees. Default 0.
        direction_deg: f64 = 0.0, -360.0..=360.0, "one turn is enough", draw rng.angle_deg();
    }
}

/// Time before the first push, s.
const STILL_S: f64 = 3.0;

impl Respiration {
    /// Push at time `t`, rad of bend.
    fn push(&self, t: f64) -> Vector2<f64> {
        let phase = TAU * (t - STILL_S).max(0.0) / self.period_s;
        toward(self.direction_deg)
            * (self.amplitude_deg.to_radians() * (0.8 * phase.sin() + 0.2 * (2.0 * phase).sin()))
    }
}

impl Law for Respiration {
    fn bend(&mut self, bend: &mut Vector2<f64>, section: &SectionState) {
        *bend += self.push(section.t);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_push_starts_late_and_repeats() {
        let r = Respiration {
            amplitude_deg: 4.0,
            direction_deg: 90.0,
            ..Respiration::default()
        };
        assert_eq!(r.push(2.9), Vector2::zeros());
        let path: Vec<f64> = (0..400)
            .map(|k| r.push(3.0 + 0.01 * f64::from(k)).y.to_degrees())
            .collect();
        let (low, high) = path
            .iter()
            .fold((0.0f64, 0.0f64), |(l, h), &y| (l.min(y), h.max(y)));
        assert!(
            low < -3.0 && high > 3.0 && low >= -4.0 && high <= 4.0,
            "{low} {high}"
        );
        assert!((r.push(8.7) - r.push(4.7)).norm() < 1e-12 && r.push(8.7).x.abs() < 1e-9);
    }
}
