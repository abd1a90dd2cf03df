//! A gyroscope whose bias drifts: it warms up, and it wanders.
//!
//! Warm-up is a stretched exponential, `b (1 − e^(−(t/τ)^0.7))`, fast at first with a long tail, plus a
//! Gauss-Markov wander of 40 s correlation time.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.gyro_bias]`
    GyroBias at "effects.gyro_bias" sized by warm_up_deg_s, wander_deg_s; drawn by rng, severity {
        let size = rng.sized(0.5, 4.0, severity);
        /// Change b of the bias by the end of the warm-up, °/s per axis. Default 0 (none); typical 0.1
        /// to 5. A larger value turns the integrated attitude faster.
        warm_up_deg_s: [f64; 3] = [0.0; 3], -50.0..=50.0, "0.1 to 5 °/s is typical", draw (rng.direction() * size).into();
        /// Time constant τ of the warm-up, s. Default 40. A larger value drifts for longer.
        over_s: f64 = 40.0, 0.1..=1e6, "a minute or so is typical", draw rng.between(15.0, 70.0);
        /// Standard deviation of the wander, °/s. Default 0. A larger value is less predictable.
        wander_deg_s: f64 = 0.0, 0.0..=20.0, "tenths of °/s are typical", draw 0.1 * size;
    }
    /// A bias that drifts, with where it has wandered.
    Drifting runs config, unit {
        rng: PlantRng = PlantRng::new(unit.seed, Stream::GyroBias);
        wander: Wander = Wander::new(config.wander_deg_s.to_radians(), 40.0, &mut rng);
        /// The value at the start is a constant bias, which is part of the nominal model.
        start: Vector3<f64> = wander.step(0.0, &mut rng);
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
            &crate::simulation::plant::PlantConfig::default().unit_data(1),
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
