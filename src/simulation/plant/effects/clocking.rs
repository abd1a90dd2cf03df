//! Bellows off their 120° places, by an angle that grows with their length.
//!
//! A bellow glued askew runs along a helix: stretched by `q` it sits at `ζ (1 + w q / 5 mm)`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.clocking]`
    Clocking at "effects.clocking" sized by offset_deg; background by up_to {
        offset_deg: [up_to(0.08), -up_to(0.08), up_to(0.08)]
    }; drawn by rng, severity {
        let size = rng.sign() * rng.sized(3.0, 18.0, severity);
        let only = rng.chance(0.6).then(|| rng.channel() - 1);
        /// How far each bellow is turned about the axis, ζ, degrees. Default 0; typical 1 to 20 on one or
        /// on all alike. All alike turn the bend's direction; one alone skews it as well.
        offset_deg: [f64; 3] = [0.0; 3], -40.0..=40.0, "a bellow cannot pass its neighbour",
            draw std::array::from_fn(|i| if only.is_none_or(|only| i == only) { size } else { 0.0 });
        /// Share w that a stretch by 5 mm adds. Default 0.08. A larger value wanders more.
        wander: f64 = 0.08, -1.0..=1.0, "a share of the offset", draw rng.between(0.03, 0.12);
    }
}

/// Stretch at which the wander counts fully, mm.
const FULL_MM: f64 = 5.0;

impl Law for Clocking {
    fn offsets(&self, bellow_mm: &Vector3<f64>) -> Option<[f64; 3]> {
        Some(std::array::from_fn(|i| {
            self.offset_deg[i].to_radians() * (1.0 + self.wander * bellow_mm[i] / FULL_MM)
        }))
    }
}
