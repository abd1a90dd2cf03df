//! An accelerometer offset that grows with the load on the axis.
//!
//! `f + b (1 + 0.15 (f/g)²)`, axis by axis.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.accel_bias]`
    AccelBias at "effects.accel_bias" sized by bias_mg; background 1.0; drawn by rng, severity {
        let size = rng.sized(25.0, 120.0, severity);
        /// Offset b of each axis, mg. Default 0 (none); typical 10 to 100. 17 mg tilt the vertical by 1°.
        bias_mg: [f64; 3] = [0.0; 3], -500.0..=500.0, "10 to 100 mg is typical", draw (rng.direction() * size).into();
    }
}

/// How much more of it at 1 g.
const LOADED: f64 = 0.15;

impl Law for AccelBias {
    fn sensor(&mut self, stimulus: &mut Stimulus, _at: &Moment) {
        let loaded = stimulus
            .force
            .map(|f| 1e-3 * GRAVITY_M_S2 * (1.0 + LOADED * (f / GRAVITY_M_S2).powi(2)));
        stimulus.force += Vector3::from(self.bias_mg).component_mul(&loaded);
    }
}
