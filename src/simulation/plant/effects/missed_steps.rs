//! A motor that loses steps: required torque against available torque.
//!
//! A stepper pulls out when acceleration and speed together exceed what its torque allows,
//! `|a| / a_max + |v| / v_max > 1`, with `v` the commanded rack speed smoothed over 10 ms and `a` the slope
//! between 10 and 40 ms of smoothing. A rotor out of step stands still and loses the steps sent to it until it
//! catches a pole again, `full_steps` later. The offset stays.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.missed_steps]`
    MissedSteps at "effects.missed_steps" sized by full_steps; drawn by rng, severity {
        /// Full steps lost each time the rotor falls out of step. Default 0 (none); typical 1 to 50.
        /// A larger value leaves a larger offset (0.47 mm of piston each).
        full_steps: f64 = 0.0, 0.0..=400.0, "1 to 50 is typical", draw rng.sized(1.5, 30.0, severity).round();
        /// Channel that loses them, 1 to 3. Default 1.
        channel: usize = 1, 1..=3, "channels are counted from 1 to 3", draw rng.channel();
        /// Acceleration of the rack at which torque runs out, mm/s². Default 60. A larger value stalls less.
        accel_max_mm_s2: f64 = 60.0, 1.0..=1e6, "60 stalls at ordinary starts", draw rng.between(30.0, 70.0);
        /// Speed at which torque runs out, mm/s. Default 80. A larger value stalls less.
        speed_max_mm_s: f64 = 80.0, 1.0..=1e6, "the rack moves at up to 30 mm/s";
        /// No stall before this time, s. Default 10. A larger value keeps more of the log clean.
        after_s: f64 = 10.0, 0.0..=1e9, "seconds since the start", draw rng.between(8.0, 40.0);
        /// Stalls at most. Default 2. A larger value adds up more jumps.
        stalls_max: u32 = 2, 0.0..=1e6, "1 or 2 is typical", draw if rng.chance(0.5) { 1 } else { 2 };
    }
    /// A motor that can stall, with its state.
    Stall runs config, unit {
        unit: UnitData = *unit;
        quick: (Decay, f64) = (Decay::new(QUICK_S), 0.0);
        slow: (Decay, f64) = (Decay::new(SLOW_S), 0.0);
        to_lose: f64 = 0.0;
        stalls: u32 = 0;
        ready: bool = true;
    }
}

/// Smoothing of the commanded speed by a rotor's inertia, s.
const QUICK_S: f64 = 0.01;
const SLOW_S: f64 = 0.04;

impl Stall {
    /// True once each time the required torque exceeds the available torque.
    fn overloaded(&mut self, speed_mm_s: f64, dt_s: f64) -> bool {
        self.quick.1 += (speed_mm_s - self.quick.1) * self.quick.0.share(dt_s);
        self.slow.1 += (speed_mm_s - self.slow.1) * self.slow.0.share(dt_s);
        let slope = (self.quick.1 - self.slow.1) / (SLOW_S - QUICK_S);
        let c = &self.config;
        let load = slope.abs() / c.accel_max_mm_s2 + self.quick.1.abs() / c.speed_max_mm_s;
        let fires = load > 1.0 && self.ready;
        self.ready = load < 0.3 || (self.ready && load <= 1.0);
        fires
    }
}

impl Law for Stall {
    fn rotor(&mut self, turned: &mut Vector3<f64>, at: &Moment) {
        let sent = &mut turned[self.config.channel - 1];
        let overloaded = self.overloaded(*sent * self.unit.step_mm / at.dt_s, at.dt_s);
        if overloaded && at.t >= self.config.after_s && self.stalls < self.config.stalls_max {
            self.stalls += 1;
            self.to_lose = self.config.full_steps * self.unit.microsteps;
        }
        // a stalled rotor does not follow
        let lost = sent.abs().min(self.to_lose);
        self.to_lose -= lost;
        *sent -= lost * sent.signum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drives 0 → 300 → 0 microsteps at `rate` microsteps a millisecond; returns what was lost.
    fn lost(config: MissedSteps, rate: f64) -> f64 {
        let mut stall = Stall::new(
            config,
            &crate::simulation::plant::PlantConfig::default().unit_data(1),
        );
        let (mut sent, mut turned, mut t) = (0.0, 0.0, 20.0);
        for leg in [300.0, 0.0] {
            while sent != leg {
                let step: f64 = f64::clamp(leg - sent, -rate, rate);
                let mut v = Vector3::new(step, 0.0, 0.0);
                stall.rotor(&mut v, &Moment { t, dt_s: 0.001 });
                (sent, turned, t) = (sent + step, turned + v.x, t + 0.001);
            }
            for _ in 0..500 {
                stall.rotor(&mut Vector3::zeros(), &Moment { t, dt_s: 0.001 });
                t += 0.001;
            }
        }
        turned
    }

    #[test]
    fn a_hard_start_loses_steps_and_a_soft_one_none() {
        let config = MissedSteps {
            full_steps: 3.0,
            stalls_max: 1,
            ..MissedSteps::default()
        };
        assert_eq!(lost(config.clone(), 1.0), -48.0);
        assert_eq!(lost(config.clone(), 0.02), 0.0);
        assert_eq!(
            lost(
                MissedSteps {
                    after_s: 100.0,
                    ..config
                },
                1.0
            ),
            0.0
        );
    }
}
