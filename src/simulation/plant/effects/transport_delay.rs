//! Dead time from command to motion.
//!
//! The microstep counts reach the motors late by a dead time that wanders; see `DeadTime`.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.transport_delay]`
    TransportDelay at "effects.transport_delay" sized by delay_s {
        /// Dead time from command to motion, s. Default 0 (none); typical 0.01 to 0.25. A larger value answers
        /// later.
        delay_s: f64 = 0.0, "", 0.0..=1.0, "0.01 to 0.25 s is typical";
        /// Wander j of the dead time, standard deviation as a share. Default 0.06. A larger value is less regular.
        jitter: f64 = 0.06, "", 0.0..=0.4, "a share of the delay";
    }
}

impl PlantEffect for TransportDelay {
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            delay_s: rng.sized(0.05, 0.25, severity),
            jitter: rng.between(0.02, 0.1),
        }
    }
}

/// Commands on their way.
#[derive(Debug, Clone)]
pub(crate) struct Late(DeadTime<Vector3<f64>>);

impl Late {
    pub(crate) fn new(config: &TransportDelay, seed: u64) -> Self {
        Self(DeadTime::new(
            config.delay_s,
            config.jitter,
            Vector3::zeros(),
            PlantRng::new(seed, Stream::TransportDelay),
        ))
    }
}

impl Law for Late {
    fn command(&mut self, counts: &mut Vector3<f64>, at: &Moment) {
        *counts = self.0.pass(at.t, at.dt_s, *counts);
    }
}
