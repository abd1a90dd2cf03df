//! A gyroscope whose bias drifts: it warms up, and it wanders.
//!
//! Warm-up is a stretched exponential, `b (1 − e^(−(t/τ)^0.7))`, fast at first with a long tail, plus a
//! Gauss-Markov wander of 40 s correlation time.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.gyro_bias]`
    GyroBias at "effects.gyro_bias" sized by warm_up_deg_s, wander_deg_s {
        /// Change b of the bias by the end of the warm-up, °/s per axis. Default 0 (none); typical 0.1
        /// to 5. A larger value turns the integrated attitude faster.
        warm_up_deg_s: [f64; 3] = [0.0; 3], "", -50.0..=50.0, "0.1 to 5 °/s is typical";
        /// Time constant τ of the warm-up, s. Default 40. A larger value drifts for longer.
        over_s: f64 = 40.0, "", 0.1..=1e6, "a minute or so is typical";
        /// Standard deviation of the wander, °/s. Default 0. A larger value is less predictable.
        wander_deg_s: f64 = 0.0, "", 0.0..=20.0, "tenths of °/s are typical";
    }
}

impl PlantEffect for GyroBias {
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let size = rng.sized(0.5, 4.0, severity);
        Self {
            warm_up_deg_s: (rng.direction() * size).into(),
            over_s: rng.between(15.0, 70.0),
            wander_deg_s: 0.1 * size,
        }
    }
}

/// A bias that drifts, with where it has wandered.
#[derive(Debug, Clone)]
pub(crate) struct Drifting {
    config: GyroBias,
    wander: Wander,
    rng: PlantRng,
    start: Vector3<f64>,
}

impl Drifting {
    pub(crate) fn new(config: GyroBias, seed: u64) -> Self {
        let mut rng = PlantRng::new(seed, Stream::GyroBias);
        let mut wander = Wander::new(config.wander_deg_s.to_radians(), 40.0, &mut rng);
        // the value at the start is a constant bias, which is part of the nominal model
        let start = wander.step(0.0, &mut rng);
        Self {
            config,
            wander,
            rng,
            start,
        }
    }
}

impl Law for Drifting {
    fn sensor(&mut self, stimulus: &mut Stimulus, at: &Moment) {
        let warm = -(-(at.t / self.config.over_s).powf(0.7)).exp_m1();
        let drift = Vector3::from(self.config.warm_up_deg_s).map(f64::to_radians) * warm;
        stimulus.rate += drift + self.wander.step(at.dt_s, &mut self.rng) - self.start;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drift_starts_at_zero_and_ends_at_its_size() {
        let mut d = Drifting::new(
            GyroBias {
                warm_up_deg_s: [1.0, 0.0, -2.0],
                ..GyroBias::default()
            },
            1,
        );
        let mut rate = |t: f64, dt_s: f64| {
            let mut stimulus = Stimulus::default();
            d.sensor(&mut stimulus, &Moment { t, dt_s });
            stimulus.rate
        };
        assert_eq!(rate(0.0, 0.0).norm(), 0.0);
        let end = rate(5000.0, 1.0).map(f64::to_degrees);
        assert!((end - Vector3::new(1.0, 0.0, -2.0)).norm() < 1e-9);
    }
}
