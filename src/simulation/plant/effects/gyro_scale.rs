//! Outside the catalogue: a gyroscope whose scale is wrong, axis by axis.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.gyro_scale]`
    GyroScale at "effects.outside.gyro_scale" sized by share; drawn by rng, severity {
        let size = rng.sized(0.03, 0.15, severity);
        /// Excess of each axis, as a share. Default 0; the data sheet allows ±0.015, plausible up to
        /// ±0.15. A larger value integrates to wronger angles.
        share: [f64; 3] = [0.0; 3], -0.5..=0.5, "up to ±0.15 is plausible",
            draw std::array::from_fn(|_| size * rng.sign() * rng.between(0.6, 1.2));
    }
}

impl Law for GyroScale {
    fn sensor(&mut self, stimulus: &mut Stimulus, _at: &Moment) {
        stimulus.rate += stimulus.rate.component_mul(&Vector3::from(self.share));
    }
}
