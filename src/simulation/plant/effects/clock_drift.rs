//! Outside the catalogue: a sensor clock that runs fast or slow.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.clock_drift]`
    ClockDrift at "effects.outside.clock_drift" sized by per_mille; drawn by rng, severity {
        /// How much faster the sensor's clock runs, parts per thousand. Default 0; plausible ±3 to 30.
        /// A larger value makes the time stamps run away, and the angles that are integrated by them.
        per_mille: f64 = 0.0, -200.0..=200.0, "tens at most are plausible", draw rng.sign() * rng.sized(5.0, 40.0, severity);
    }
}

impl Law for ClockDrift {
    fn clock(&self, t: f64) -> f64 {
        t * (1.0 + 1e-3 * self.per_mille)
    }
}
