//! Outside the catalogue: soft iron stretches the field along one body-fixed direction.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.soft_iron]`
    SoftIron at "effects.outside.soft_iron" sized by stretch; directed by direction; drawn by rng, severity {
        /// Stretch of the field along the direction, as a share. Default 0 (none); plausible ±0.05 to
        /// 0.3. A larger value turns the heading more, twice per turn.
        stretch: f64 = 0.0, -0.9..=5.0, "±0.05 to 0.3 is plausible", draw rng.sized(0.06, 0.35, severity);
        /// Direction in the body, any length. Default [1, 0, 0].
        direction: [f64; 3] = [1.0, 0.0, 0.0], -1e3..=1e3, "a direction", draw rng.direction().into();
    }
}

impl Law for SoftIron {
    fn sensor(&mut self, stimulus: &mut Stimulus, _at: &Moment) {
        let along = Vector3::from(self.direction).normalize();
        stimulus.field += along * (self.stretch * along.dot(&stimulus.field));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_is_stretched_along_one_direction() {
        let mut stimulus = Stimulus {
            field: Vector3::new(10.0, 20.0, 0.0),
            ..Stimulus::default()
        };
        SoftIron {
            stretch: 0.5,
            direction: [0.0, 2.0, 0.0],
        }
        .sensor(&mut stimulus, &Moment { t: 0.0, dt_s: 0.0 });
        assert!((stimulus.field - Vector3::new(10.0, 30.0, 0.0)).norm() < 1e-12);
    }
}
