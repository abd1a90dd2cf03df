//! Dead time from motion to sample.
//!
//! What the sensor measures is late by a dead time that wanders; see `DeadTime`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.sensor_latency]`
    SensorLatency at "effects.sensor_latency" sized by latency_s; drawn by rng, severity {
        /// Age of a sample when it is handed over, s. Default 0 (none); typical 0.01 to 0.25. A larger value
        /// shows the past.
        latency_s: f64 = 0.0, 0.0..=1.0, "0.01 to 0.25 s is typical", draw rng.sized(0.05, 0.25, severity);
        /// Wander j of the dead time, standard deviation as a share. Default 0.06. A larger value is less regular.
        jitter: f64 = 0.06, 0.0..=0.4, "a share of the latency", draw rng.between(0.02, 0.1);
    }
    /// Measured quantities on their way.
    Late runs config, unit {
        line: DeadTime<Stimulus> =
            DeadTime::new(config.latency_s, config.jitter, Stimulus::default(), PlantRng::new(unit.seed, Stream::SensorLatency));
    }
}

impl Law for Late {
    fn at_start(&mut self, stimulus: &Stimulus) {
        self.line.fill(*stimulus);
    }
    fn late(&mut self, stimulus: &mut Stimulus, at: &Moment) {
        *stimulus = self.line.pass(at.t, at.dt_s, *stimulus);
    }
}
