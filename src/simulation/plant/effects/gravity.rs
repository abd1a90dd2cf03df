//! The tip's weight: the bend at which elastic and potential energy together are least.
//!
//! `½ |b − b₀|²/C + m g h(b) → min`, so `b = b₀ − C' ∇h(b)` with `h` the height of the weight, which
//! sits `com` beyond the tip plate along the tip's axis, in the world as the base is held now. It is solved
//! by fixed-point iteration from the last solution; each round shrinks the error about tenfold.

use crate::simulation::plant::prelude::*;
use crate::simulation::plant::shape::arc::Terms;

effect! {
    /// `[effects.gravity]`
    Gravity at "effects.gravity" sized by sag_deg; background 0.1; drawn by rng, severity {
        /// Sag of the straight tip when the base is held level, degrees. Default 0 (none); typical 1 to
        /// 10 (the paper's tip weighs 2.6 g). A larger value follows the vertical more.
        sag_deg: f64 = 0.0, 0.0..=25.0, "1 to 10 is typical", draw rng.sized(2.5, 10.0, severity);
        /// Where the weight sits beyond the tip plate, mm. Default 5. A larger value makes a bent tip heavier
        /// compared with a straight one.
        com_mm: f64 = 5.0, 0.0..=50.0, "half the length of the rigid tip", draw rng.between(3.0, 9.0);
    }
    /// The weight with the last solution.
    Weight runs config, unit {
        /// C m g, rad per mm of height gradient.
        compliance: f64 = config.sag_deg.to_radians() / (0.5 * unit.rest_length_mm + config.com_mm);
        sag: Vector2<f64> = Vector2::zeros();
    }
}

/// Rounds of the fixed point at most.
const ROUNDS: usize = 12;
/// The fixed point ends below this step, rad.
const CLOSE: f64 = 1e-8;

impl Law for Weight {
    fn bend(&mut self, bend: &mut Vector2<f64>, section: &SectionState) {
        let up = section.r_world_plate.inverse().apply(&Vector3::z());
        for _ in 0..ROUNDS {
            let uphill = self.climb(&(*bend + self.sag), section.length_mm, &up);
            let next = uphill * -self.compliance;
            let step = next - self.sag;
            self.sag = next;
            if step.norm() < CLOSE {
                break;
            }
        }
        *bend += self.sag;
    }
}

impl Weight {
    /// ∇h: how much higher the weight gets per bend, mm/rad.
    fn climb(&self, bend: &Vector2<f64>, length_mm: f64, up: &Vector3<f64>) -> Vector2<f64> {
        let t = Terms::of(bend);
        let (l, c) = (length_mm, self.config.com_mm);
        let (across, across_slope) = (l * t.v + c * t.s, l * t.dv + c * t.ds);
        let along_slope = l * t.ds - c * t.s;
        let turning = across_slope * (bend.x * up.x - bend.y * up.y) + along_slope * up.z;
        let x = across * up.x + bend.x * turning;
        Vector2::new(x, -across * up.y + bend.y * turning)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::Rotation;

    /// The bend with the weight on and the base pitched, from the bend `free` without it.
    fn sagged(w: &mut Weight, free: &Vector2<f64>, pitch_deg: f64) -> Vector2<f64> {
        let attitude = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), pitch_deg.to_radians());
        let section = SectionState {
            t: 0.0,
            length_mm: 20.0,
            longer_mm: 0.0,
            r_world_plate: Rotation::assert_frames(attitude),
        };
        let mut bend = *free;
        w.bend(&mut bend, &section);
        bend
    }

    #[test]
    fn the_gradient_is_that_of_the_height() {
        let w = Weight::new(
            Gravity {
                sag_deg: 5.0,
                com_mm: 6.0,
            },
            &crate::simulation::plant::PlantConfig::default().unit_data(1),
        );
        let up = Vector3::new(0.4, -0.5, 0.3);
        let height = |b: Vector2<f64>| {
            let t = Terms::of(&b);
            (t.tip_mm(&b, 21.0) + Vector3::new(b.x * t.s, -b.y * t.s, b.norm().cos()) * 6.0)
                .dot(&up)
        };
        for b in [
            Vector2::new(0.9, -0.4),
            Vector2::new(0.02, 0.01),
            Vector2::zeros(),
        ] {
            let h = 1e-6;
            let slope = |d: Vector2<f64>| (height(b + d * h) - height(b - d * h)) / (2.0 * h);
            let want = Vector2::new(slope(Vector2::x()), slope(Vector2::y()));
            assert!((w.climb(&b, 21.0, &up) - want).norm() < 1e-6);
        }
    }

    #[test]
    fn a_level_tip_sags_and_an_upright_one_bends_further() {
        let mut w = Weight::new(
            Gravity {
                sag_deg: 5.0,
                ..Gravity::default()
            },
            &crate::simulation::plant::PlantConfig::default().unit_data(1),
        );
        let level = sagged(&mut w, &Vector2::zeros(), 90.0);
        // pitched by 90°, the base's x axis points down
        assert!(
            (level.x.to_degrees() - 5.0).abs() < 0.1 && level.y.abs() < 1e-9,
            "{level}"
        );
        let bent = Vector2::new(0.8, 0.0);
        let upright = sagged(&mut w, &bent, 0.0) - bent;
        let hanging = sagged(&mut w, &bent, 180.0) - bent;
        assert!(upright.x > 0.02 && hanging.x < -0.02);
        assert!(sagged(&mut w, &Vector2::zeros(), 0.0).norm() < 1e-9);
    }
}
