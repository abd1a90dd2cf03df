//! Magnetised parts that turn with the sensor, some of which are magnetised slowly.
//!
//! A constant body-fixed field `b`, plus `v |b|` along the field that the parts have been in over the
//! last 15 s (magnetic viscosity).

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.hard_iron]`
    HardIron at "effects.hard_iron" sized by offset_ut; background 0.06; drawn by rng, severity {
        let size = rng.sized(4.0, 40.0, severity);
        /// Field b of the parts, µT per axis. Default 0 (none); typical 1 to 50. A larger value turns the heading
        /// more.
        offset_ut: [f64; 3] = [0.0; 3], -500.0..=500.0, "1 to 50 µT is typical", draw (rng.direction() * size).into();
        /// Share v that follows slowly. Default 0.1. A larger value remembers attitudes more.
        viscous: f64 = 0.1, 0.0..=1.0, "0.1 is typical", draw rng.between(0.02, 0.15);
    }
    /// Parts with the field they have acquired.
    Iron runs config {
        decay: Decay = Decay::new(VISCOUS_S);
        acquired: Option<Vector3<f64>> = None;
    }
}

/// Time over which parts are magnetised, s.
const VISCOUS_S: f64 = 15.0;

impl Law for Iron {
    fn sensor(&mut self, stimulus: &mut Stimulus, at: &Moment) {
        // before the first sample the parts have been in the same field
        let before = self.acquired.unwrap_or(stimulus.field);
        let acquired = before + (stimulus.field - before) * self.decay.share(at.dt_s);
        self.acquired = Some(acquired);
        let offset = Vector3::from(self.config.offset_ut);
        stimulus.field += offset
            + acquired.try_normalize(1e-9).unwrap_or_default()
                * (self.config.viscous * offset.norm());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_is_fixed_to_the_body_except_for_its_viscous_part() {
        let mut iron = Iron::new(HardIron {
            offset_ut: [10.0, 0.0, 0.0],
            viscous: 0.1,
        });
        let mut field = |y: f64| {
            let outer = Vector3::new(0.0, y, 0.0);
            let mut stimulus = Stimulus {
                field: outer,
                ..Stimulus::default()
            };
            iron.sensor(&mut stimulus, &Moment { t: 0.0, dt_s: 0.01 });
            stimulus.field - outer
        };
        let first = field(40.0);
        assert!((first - Vector3::new(10.0, 1.0, 0.0)).norm() < 1e-9);
        let turned = field(-40.0);
        assert!((turned - first).norm() < 0.01);
        for _ in 0..20_000 {
            field(-40.0);
        }
        assert!((field(-40.0) - Vector3::new(10.0, -1.0, 0.0)).norm() < 1e-3);
    }
}
