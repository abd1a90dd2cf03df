//! When commands arrive and when samples were true, with clocks that disagree.
//!
//! Both dead times wander: `T (1 + j x(t))`, with `x` a unit Gauss-Markov process of 1 s correlation
//! time, bounded at ±2.5. What lies between two known moments is taken as a straight line.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::memory::{Delay, Mix, Wander};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::{PlantRng, Stream};
use serde::{Deserialize, Serialize};

/// `[effects.transport_delay]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransportDelay {
    /// Dead time from command to motion, s. Default 0 (none); typical 0.01 to 0.25. Bigger answers
    /// later.
    pub delay_s: f64,
    /// Wander j of it, standard deviation as a share. Default 0.06. Bigger is less regular.
    pub jitter: f64,
}

/// `[effects.sensor_latency]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorLatency {
    /// Age of a sample when it is handed over, s. Default 0 (none); typical 0.01 to 0.25. Bigger
    /// shows the past.
    pub latency_s: f64,
    /// Wander j of it, standard deviation as a share. Default 0.06. Bigger is less regular.
    pub jitter: f64,
}

impl Default for TransportDelay {
    fn default() -> Self {
        Self { delay_s: 0.0, jitter: 0.06 }
    }
}

impl Default for SensorLatency {
    fn default() -> Self {
        Self { latency_s: 0.0, jitter: 0.06 }
    }
}

/// Longest dead time that can be made, s.
const LONGEST_S: f64 = 1.0;
/// Shortest step of the caller for which room is set aside, s.
const STEP_MIN_S: f64 = 2e-4;
/// Correlation time of the wander, s, and its bound in standard deviations.
const WANDER_S: f64 = 1.0;
const WANDER_MAX: f64 = 2.5;

impl PlantEffect for TransportDelay {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.transport_delay.delay_s", self.delay_s, 0.0..=LONGEST_S, "0.01 to 0.25 s is typical")?;
        range("effects.transport_delay.jitter", self.jitter, 0.0..=0.4, "a share of the delay")
    }
    fn size(&self) -> f64 {
        self.delay_s
    }
    fn scale(&mut self, factor: f64) {
        self.delay_s = (self.delay_s * factor).min(LONGEST_S);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { delay_s: rng.sized(0.05, 0.25, severity), jitter: rng.between(0.02, 0.1) }
    }
}

impl PlantEffect for SensorLatency {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.sensor_latency.latency_s", self.latency_s, 0.0..=LONGEST_S, "0.01 to 0.25 s is typical")?;
        range("effects.sensor_latency.jitter", self.jitter, 0.0..=0.4, "a share of the latency")
    }
    fn size(&self) -> f64 {
        self.latency_s
    }
    fn scale(&mut self, factor: f64) {
        self.latency_s = (self.latency_s * factor).min(LONGEST_S);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { latency_s: rng.sized(0.05, 0.25, severity), jitter: rng.between(0.02, 0.1) }
    }
}

/// A dead time that wanders.
#[derive(Debug, Clone)]
pub(crate) struct DeadTime<T> {
    delay_s: f64,
    jitter: f64,
    line: Delay<T>,
    wander: Wander,
    rng: PlantRng,
}

impl<T: Mix> DeadTime<T> {
    /// Of commands.
    pub(crate) fn transport(config: &TransportDelay, rest: T, seed: u64) -> Self {
        Self::new(config.delay_s, config.jitter, rest, PlantRng::new(seed, Stream::TransportDelay))
    }
    /// Of samples.
    pub(crate) fn latency(config: &SensorLatency, rest: T, seed: u64) -> Self {
        Self::new(config.latency_s, config.jitter, rest, PlantRng::new(seed, Stream::SensorLatency))
    }
    fn new(delay_s: f64, jitter: f64, rest: T, mut rng: PlantRng) -> Self {
        let reach_s = delay_s * (1.0 + jitter * WANDER_MAX);
        let wander = Wander::new(1.0, WANDER_S, &mut rng);
        Self { delay_s, jitter, line: Delay::new(reach_s, STEP_MIN_S, rest), wander, rng }
    }
    /// Takes what is true at `t` and gives what arrives then.
    pub(crate) fn pass(&mut self, t: f64, dt_s: f64, value: T) -> T {
        self.line.push(t, value);
        let x = self.wander.step(dt_s, &mut self.rng).x.clamp(-WANDER_MAX, WANDER_MAX);
        self.line.at(t - self.delay_s * (1.0 + self.jitter * x))
    }
}

/// `[effects.outside.clock_drift]`: outside the catalogue, a sensor clock that runs fast or slow.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockDrift {
    /// How much faster the sensor's clock runs, parts per thousand. Default 0; plausible ±3 to 30.
    /// Bigger makes the time stamps run away, and the angles that are integrated by them.
    pub per_mille: f64,
}

impl PlantEffect for ClockDrift {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.clock_drift.per_mille", self.per_mille, -200.0..=200.0, "tens at most are plausible")
    }
    fn size(&self) -> f64 {
        self.per_mille
    }
    fn scale(&mut self, factor: f64) {
        self.per_mille *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { per_mille: rng.sign() * rng.sized(5.0, 40.0, severity) }
    }
}

impl ClockDrift {
    /// What the sensor's clock shows at `t`.
    pub(crate) fn shown(&self, t: f64) -> f64 {
        t * (1.0 + 1e-3 * self.per_mille)
    }
}

/// `[effects.outside.sensor_freeze]`: outside the catalogue, a sensor that hangs now and then and
/// repeats its last reading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorFreeze {
    /// How long it hangs, s. Default 0 (never); plausible 0.3 to 3. Bigger blinds for longer.
    pub for_s: f64,
    /// When it first hangs, s. Default 12.
    pub at_s: f64,
    /// Time from one hang to the next, s. Default 25. Bigger hangs less often.
    pub every_s: f64,
}

impl Default for SensorFreeze {
    fn default() -> Self {
        Self { for_s: 0.0, at_s: 12.0, every_s: 25.0 }
    }
}

impl PlantEffect for SensorFreeze {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.sensor_freeze.for_s", self.for_s, 0.0..=1e4, "some seconds are plausible")?;
        range("effects.outside.sensor_freeze.at_s", self.at_s, 0.0..=1e9, "seconds since the start")?;
        range("effects.outside.sensor_freeze.every_s", self.every_s, 0.01..=1e9, "longer than it hangs")
    }
    fn size(&self) -> f64 {
        self.for_s
    }
    fn scale(&mut self, factor: f64) {
        self.for_s *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { for_s: rng.sized(0.5, 3.0, severity), at_s: rng.between(8.0, 20.0), every_s: rng.between(10.0, 25.0) }
    }
}

impl SensorFreeze {
    /// It hangs at `t`.
    pub(crate) fn hangs(&self, t: f64) -> bool {
        t >= self.at_s && (t - self.at_s) % self.every_s < self.for_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_ramp_comes_late_by_the_dead_time_at_every_step() {
        for dt in [0.0005, 0.001, 0.005, 0.01] {
            let mut d = DeadTime::transport(&TransportDelay { delay_s: 0.083, jitter: 0.0 }, Vector3::zeros(), 1);
            let n = (0.5f64 / dt).round() as usize;
            let late = (1..=n).map(|k| k as f64 * dt).map(|t| t - d.pass(t, dt, Vector3::repeat(t)).x).last().unwrap();
            assert!((late - 0.083).abs() < 1e-9, "{dt} {late}");
        }
    }

    #[test]
    fn the_wander_is_bounded_and_there() {
        let mut d = DeadTime::latency(&SensorLatency { latency_s: 0.1, jitter: 0.1 }, Vector3::zeros(), 2);
        let late: Vec<f64> =
            (1..20_000).map(|k| f64::from(k) * 0.002).map(|t| t - d.pass(t, 0.002, Vector3::repeat(t)).x).skip(100).collect();
        let (low, high) = late.iter().fold((1.0f64, 0.0f64), |(l, h), &x| (l.min(x), h.max(x)));
        assert!(low > 0.074 && low < 0.09 && high < 0.126 && high > 0.11, "{low} {high}");
    }

    #[test]
    fn a_freeze_comes_back() {
        let f = SensorFreeze { for_s: 1.0, at_s: 5.0, every_s: 10.0 };
        assert!(!f.hangs(4.9) && f.hangs(5.5) && !f.hangs(6.5) && f.hangs(15.5));
    }
}
