//! The tip bends by more or less than constant curvature predicts, the same in all directions.
//!
//! End caps stay straight and the middle bends first: `β' = β + A (β/β₀) tanh((β/β₀)²) / tanh 1`,
//! which is `A` at `β₀ = 60°`, flat when straight and proportional at large bends.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.curvature]`
    Curvature at "effects.curvature" sized by excess_deg; background 0.1; drawn by rng, severity {
        /// Extra bend A at 60°, degrees. Default 0 (none); typical ±1 to 10. A larger value bends more at large
        /// angles only.
        excess_deg: f64 = 0.0, -25.0..=25.0, "±1 to 10 is typical", draw rng.sign() * rng.sized(3.0, 10.0, severity);
    }
}

/// Angle at which the excess is counted, rad.
const FULL: f64 = std::f64::consts::FRAC_PI_3;

impl Law for Curvature {
    fn bend(&mut self, bend: &mut Vector2<f64>, _section: &SectionState) {
        let x2 = bend.norm_squared() / (FULL * FULL);
        *bend *= 1.0 + self.excess_deg.to_radians() / FULL * x2.tanh() / 1f64.tanh();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::frames::Rotation;

    #[test]
    fn the_excess_is_isotropic_and_stated_at_sixty_degrees() {
        let mut c = Curvature { excess_deg: 5.0 };
        let section = SectionState {
            t: 0.0,
            length_mm: 20.0,
            longer_mm: 0.0,
            r_world_plate: Rotation::identity(),
        };
        let mut bent = |mut bend: Vector2<f64>| {
            c.bend(&mut bend, &section);
            bend.norm()
        };
        for deg in [0.0, 77.0, 200.0f64] {
            let u = Vector2::new(deg.to_radians().cos(), deg.to_radians().sin());
            assert!((bent(u * FULL).to_degrees() - 65.0).abs() < 1e-9);
            assert!((bent(u * 0.1) / 0.1 - 1.0).abs() < 2e-3);
        }
    }
}
