//! Dead time from command to motion.
//!
//! The microstep counts reach the motors late by a dead time that wanders; see `DeadTime`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.transport_delay]`
    TransportDelay at "effects.transport_delay" sized by delay_s; drawn by rng, severity {
        /// Dead time from command to motion, s. Default 0 (none); typical 0.01 to 0.25. A larger value answers
        /// later.
        delay_s: f64 = 0.0, 0.0..=1.0, "0.01 to 0.25 s is typical", draw rng.sized(0.05, 0.25, severity);
        /// Wander j of the dead time, standard deviation as a share. Default 0.06. A larger value is less regular.
        jitter: f64 = 0.06, 0.0..=0.4, "a share of the delay", draw rng.between(0.02, 0.1);
    }
    /// Commands on their way.
    Late runs config, unit {
        line: DeadTime<Vector3<f64>> =
            DeadTime::new(config.delay_s, config.jitter, Vector3::zeros(), PlantRng::new(unit.seed, Stream::TransportDelay));
    }
}

impl Law for Late {
    fn command(&mut self, counts: &mut Vector3<f64>, at: &Moment) {
        *counts = self.line.pass(at.t, at.dt_s, *counts);
    }
}
