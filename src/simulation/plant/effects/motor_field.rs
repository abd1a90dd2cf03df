//! The motors' own field: fixed in the world, turning with the coil currents, weaker when idle.
//!
//! A two-phase stepper goes through one cycle of currents in four full steps: `φ = 2π n / (4 m)` with
//! `m` microsteps a full step. Its iron saturates, which adds a third harmonic:
//! `A I (u (cos φ + h cos 3φ) + w (sin φ − h sin 3φ))`, `u` and `w` across the motor's axis. The
//! driver reduces the current `I` to its idle share once a channel stands still.

use crate::simulation::plant::prelude::*;
use std::f64::consts::TAU;

effect! {
    /// `[effects.motor_field]`
    MotorField at "effects.motor_field" sized by amplitude_ut; background 0.02; drawn by rng, severity {
        let size = rng.sized(1.5, 20.0, severity);
        /// Amplitude A of each motor's field where the tip is, µT. Default 0 (none); typical 0.1 to 20.
        /// A larger value disturbs the heading more.
        amplitude_ut: [f64; 3] = [0.0; 3], -500.0..=500.0, "0.1 to 20 µT is typical",
            draw std::array::from_fn(|_| size * rng.between(0.6, 1.2));
        /// Direction in which each motor's first coil points, degrees about the world's vertical.
        /// Default [0, 60, 120].
        azimuth_deg: [f64; 3] = [0.0, 60.0, 120.0], -360.0..=360.0, "one turn is enough",
            draw [rng.angle_deg(), rng.angle_deg(), rng.angle_deg()];
        /// Share h of the third harmonic. Default 0.12. A larger value is further from a circle.
        saturation: f64 = 0.12, 0.0..=1.0, "0.12 is typical", draw rng.between(0.05, 0.2);
        /// Current at standstill as a share of the current in motion. Default 0.5. A smaller value gives a
        /// larger difference between motion and standstill.
        idle: f64 = 0.5, 0.0..=1.0, "0.5 is a common driver setting", draw rng.between(0.3, 0.7);
    }
    /// Motors with their currents.
    Motors runs config, unit {
        cycle: f64 = 4.0 * unit.microsteps;
        counts: Vector3<f64> = Vector3::zeros();
        current: Vector3<f64> = Vector3::repeat(config.idle);
        decay: Decay = Decay::new(CURRENT_S);
    }
}

/// How fast the driver lets the current down and up again, s.
const CURRENT_S: f64 = 0.12;

impl Law for Motors {
    fn field(&mut self, field_ut: &mut Vector3<f64>, counts: &Vector3<f64>, dt_s: f64) {
        let share = self.decay.share(dt_s);
        let mut field = Vector3::zeros();
        for i in 0..3 {
            let idle = counts[i] == self.counts[i];
            let target = if idle { self.config.idle } else { 1.0 };
            // up at once, down slowly: a driver boosts on the first pulse
            let down = self.current[i] + (target - self.current[i]) * share;
            self.current[i] = target.max(down);
            field += self.coils(i, counts[i]) * (self.config.amplitude_ut[i] * self.current[i]);
        }
        self.counts = *counts;
        *field_ut += field;
    }
}

impl Motors {
    /// Field of one motor at unit current.
    fn coils(&self, i: usize, counts: f64) -> Vector3<f64> {
        let phase = TAU * counts / self.cycle;
        let h = self.config.saturation;
        let first = phase.cos() + h * (3.0 * phase).cos();
        let second = phase.sin() - h * (3.0 * phase).sin();
        let (sin, cos) = self.config.azimuth_deg[i].to_radians().sin_cos();
        Vector3::new(cos * first, sin * first, second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_repeats_every_64_microsteps_and_weakens_at_standstill() {
        let mut m = Motors::new(
            MotorField {
                amplitude_ut: [5.0, 0.0, 0.0],
                ..MotorField::default()
            },
            &crate::simulation::plant::PlantConfig::default().unit_data(1),
        );
        let at_seven = |m: &mut Motors| {
            let mut field_ut = Vector3::zeros();
            m.field(&mut field_ut, &Vector3::new(7.0, 0.0, 0.0), 0.002);
            field_ut
        };
        let moving = at_seven(&mut m);
        assert!(
            (m.coils(0, 7.0) - m.coils(0, 71.0)).norm() < 1e-9
                && (m.coils(0, 7.0) - m.coils(0, 39.0)).norm() > 1.0
        );
        for _ in 0..1000 {
            at_seven(&mut m);
        }
        let idle = at_seven(&mut m);
        assert!((idle.norm() / moving.norm() - 0.5).abs() < 1e-3);
    }
}
