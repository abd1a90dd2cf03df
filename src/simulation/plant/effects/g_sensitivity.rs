//! Outside the catalogue: a gyroscope that responds to specific force.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.g_sensitivity]`
    GSensitivity at "effects.outside.g_sensitivity" sized by deg_s_per_g; drawn by rng, severity {
        let size = rng.sized(0.6, 4.0, severity);
        /// Rate that each axis of the gyroscope reads under 1 g along it, °/s. Default 0; plausible ±0.1
        /// to 3. A larger value makes the bias depend on attitude.
        deg_s_per_g: [f64; 3] = [0.0; 3], -50.0..=50.0, "a few °/s are plausible", draw (rng.direction() * size).into();
    }
}

impl Law for GSensitivity {
    fn sensor(&mut self, stimulus: &mut Stimulus, _at: &Moment) {
        let rate = Vector3::from(self.deg_s_per_g).component_mul(&stimulus.force);
        stimulus.rate += rate.map(|x| (x / GRAVITY_M_S2).to_radians());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_g_adds_the_stated_rate() {
        let mut stimulus = Stimulus {
            force: Vector3::new(0.0, 0.0, GRAVITY_M_S2),
            ..Stimulus::default()
        };
        GSensitivity {
            deg_s_per_g: [0.0, 0.0, 2.0],
        }
        .sensor(&mut stimulus, &Moment { t: 0.0, dt_s: 0.0 });
        assert!((stimulus.rate.z.to_degrees() - 2.0).abs() < 1e-12);
    }
}
