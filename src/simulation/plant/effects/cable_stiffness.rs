//! A camera cable or an irrigation line beside the axis makes bending anisotropic.
//!
//! Bending across the cable is easy and bending along it is not; the cable pulls taut one way and buckles the
//! other. With `x = b·u` the bend along the cable's side `u`, it takes back `c x (1 + o y/√(1 + y²)) u`,
//! `y = x / 0.3`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.cable_stiffness]`
    CableStiffness at "effects.cable_stiffness" sized by share; background by up_to {
        share: up_to(0.0015),
        direction_deg: up_to(180.0)
    }; drawn by rng, severity {
        /// Share c of the bend that the cable takes back in its own plane, mean of both ways. Default 0
        /// (none); typical 0.05 to 0.4. A larger value bends less in that plane.
        share: f64 = 0.0, 0.0..=0.48, "0.05 to 0.4 is typical", draw rng.sized(0.1, 0.4, severity);
        /// Bend direction in which the cable is pulled taut, degrees. Default 0.
        direction_deg: f64 = 0.0, -360.0..=360.0, "one turn is enough", draw rng.angle_deg();
        /// How much stiffer it is pulled taut than buckled, 0 to 1. Default 0.35. A larger value differs more.
        one_sided: f64 = 0.35, 0.0..=1.0, "0 resists alike both ways", draw rng.between(0.1, 0.6);
    }
    /// A cable in its place.
    Cable runs config {
        side: Vector2<f64> = toward(config.direction_deg);
    }
}

/// Bend over which it turns from buckled to taut, rad.
const KNEE: f64 = 0.3;

impl Law for Cable {
    fn bend(&mut self, bend: &mut Vector2<f64>, _section: &SectionState) {
        let x = bend.dot(&self.side);
        let y = x / KNEE;
        *bend -= self.side
            * (self.config.share * x * (1.0 + self.config.one_sided * y / (1.0 + y * y).sqrt()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::frames::Rotation;

    #[test]
    fn the_cable_acts_both_ways_and_more_when_taut() {
        let section = SectionState {
            t: 0.0,
            length_mm: 20.0,
            longer_mm: 0.0,
            r_world_plate: Rotation::identity(),
        };
        let mut c = Cable::new(CableStiffness {
            share: 0.2,
            direction_deg: 30.0,
            one_sided: 0.3,
        });
        let mut along = |deg: f64| {
            let free = Vector2::new(deg.to_radians().cos(), deg.to_radians().sin());
            let mut bend = free;
            c.bend(&mut bend, &section);
            (free - bend).norm()
        };
        assert!(along(120.0) < 1e-12 && along(300.0) < 1e-12);
        assert!(along(30.0) > along(210.0) && along(210.0) > 0.13);
    }
}
