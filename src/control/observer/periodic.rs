//! A periodic disturbance, such as respiration, in what the laws do not explain.
//!
//! A bank of small Kalman filters, one a frequency: each has an offset (a random walk along the path) and an oscillator with two
//! harmonics per axis; the first has the offset alone. The frequency whose innovations are likeliest is believed once it beats the
//! offset alone (multiple-model estimation, Magill 1965).

use crate::parameters;
use crate::primitives::FOREIGN_SIGMAS;
use nalgebra::{SMatrix, SVector, Vector2};
use std::f64::consts::TAU;

parameters! {
    /// A periodic disturbance that the loop cancels.
    pub struct PeriodicConfig: Copy {
        /// Cancels a periodic disturbance once it is likelier than none.
        enabled: bool = true;
        /// Lead of the likelihood, in nats over `memory_s`, with which a period is believed. A larger value takes longer to believe, and
        /// misses weaker disturbances.
        believed: f64 = 2.5, "nat", 0.1..=100.0, "2.5 is twelve to one";
        /// Memory of the likelihoods. A larger value is surer and later.
        memory_s: f64 = 20.0, "s", 1.0..=600.0, "20 is four breaths";
        /// Amplitude of the fundamental before it is known. A larger value finds larger disturbances sooner.
        amplitude_deg: f64 = 3.0, "deg", 0.1..=30.0, "3 is what respiration makes at the tip";
    }
}

/// Number of harmonics, and the amplitude of each relative to the first.
const HARMONICS: usize = 3;
const RELATIVE: [f64; HARMONICS] = [1.0, 0.4, 0.3];
/// States per axis: offset, then cosine and sine of each harmonic.
const STATES: usize = 1 + 2 * HARMONICS;
/// Number of frequencies.
const FREQUENCIES: usize = 16;
/// The lowest and the highest, Hz: 10 to 29 breaths a minute.
const BREATHS_HZ: [f64; 2] = [0.16, 0.48];

crate::constants! {
    /// Prior and noise of a filter, and when a disturbance is believed.
    const BREATH: BreathConstants;
    /// Random walk of the fundamental, rad/√s; less for the harmonics.
    walk = 0.006;
    /// Random walk of the offset per rad of path, rad.
    path_walk = 0.03;
    /// Random walk of the offset per √s, rad.
    drift = 0.0035;
    /// Standard deviation of the offset at first, rad.
    offset_rad = 0.02;
    /// Amplitude from which a disturbance is worth cancelling, rad (0.35°).
    worth_rad = 0.006;
    /// Lead with which another frequency replaces the one believed, nat.
    better = 1.0;
    /// Share of a sample that is independent of those before, within a breath.
    independent = 0.1;
    /// Interval between two updates, s.
    period_s = 0.02;
    /// Time before a first belief, s.
    first_s = 2.0;
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Oscillator {
    rate_rad_s: f64,
    states: [SVector<f64, STATES>; 2],
    covariance: SMatrix<f64, STATES, STATES>,
    cost: f64,
}

impl Oscillator {
    fn new(hertz: f64, amplitude_rad: f64) -> Self {
        let mut covariance = SMatrix::zeros();
        covariance[(0, 0)] = BREATH.offset_rad * BREATH.offset_rad;
        if hertz > 0.0 {
            for k in 1..STATES {
                covariance[(k, k)] = (amplitude_rad * RELATIVE[(k - 1) / 2]).powi(2) / 2.0;
            }
        }
        Self {
            rate_rad_s: TAU * hertz,
            states: [SVector::zeros(); 2],
            covariance,
            cost: 0.0,
        }
    }

    fn predict(&mut self, config: &PeriodicConfig, moved: f64, dt_s: f64) {
        self.covariance[(0, 0)] +=
            BREATH.path_walk * BREATH.path_walk * moved + BREATH.drift * BREATH.drift * dt_s;
        if self.rate_rad_s == 0.0 {
            return;
        }
        let mut turn = SMatrix::<f64, STATES, STATES>::identity();
        for k in 0..HARMONICS {
            let (sin, cos) = (self.rate_rad_s * (k + 1) as f64 * dt_s).sin_cos();
            let i = 1 + 2 * k;
            let rotation = SMatrix::<f64, 2, 2>::new(cos, sin, -sin, cos);
            turn.fixed_view_mut::<2, 2>(i, i).copy_from(&rotation);
        }
        self.states = self.states.map(|x| turn * x);
        self.covariance = turn * self.covariance * turn.transpose();
        let amplitude = config.amplitude_deg.to_radians();
        for k in 1..STATES {
            let harmonic = (k - 1) / 2;
            let walk = (BREATH.walk / (harmonic + 1) as f64).powi(2) * dt_s;
            self.covariance[(k, k)] =
                (self.covariance[(k, k)] + walk).min((amplitude * RELATIVE[harmonic]).powi(2));
        }
    }

    /// Takes the residual; returns the cost of its innovation, nat, and whether it was an outlier.
    fn correct(&mut self, residual: &Vector2<f64>, variance: f64) -> (f64, bool) {
        let mut row = SVector::<f64, STATES>::zeros();
        row[0] = 1.0;
        if self.rate_rad_s > 0.0 {
            (0..HARMONICS).for_each(|k| row[1 + 2 * k] = 1.0);
        }
        let about = self.covariance * row;
        let expected = row.dot(&about) + variance;
        let gain = about / expected;
        // an innovation counts no further
        let most_2 = FOREIGN_SIGMAS * FOREIGN_SIGMAS;
        let (mut cost, mut outlier) = (0.0, false);
        for axis in 0..2 {
            let innovation = residual[axis] - row.dot(&self.states[axis]);
            self.states[axis] += gain * innovation;
            let normalised_2 = innovation * innovation / expected;
            outlier |= normalised_2 > most_2;
            cost += 0.5 * (normalised_2.min(most_2) + expected.ln());
        }
        self.covariance -= gain * about.transpose();
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        (cost, outlier)
    }

    fn amplitude(&self) -> f64 {
        let square = |x: &SVector<f64, STATES>| x.rows(1, STATES - 1).norm_squared();
        (square(&self.states[0]) + square(&self.states[1])).sqrt()
    }
}

/// The bank.
#[derive(Debug, Clone, PartialEq)]
pub struct Periodic {
    bank: [Oscillator; 1 + FREQUENCIES],
    believed: Option<usize>,
    age_s: f64,
    due_s: f64,
    path: f64,
}

impl Periodic {
    /// Nothing known.
    pub fn new(config: &PeriodicConfig) -> Self {
        let hertz = |k: usize| {
            if k == 0 {
                return 0.0;
            }
            BREATHS_HZ[0]
                * (BREATHS_HZ[1] / BREATHS_HZ[0]).powf((k - 1) as f64 / (FREQUENCIES - 1) as f64)
        };
        let amplitude_rad = config.amplitude_deg.to_radians();
        Self {
            bank: std::array::from_fn(|k| Oscillator::new(hertz(k), amplitude_rad)),
            believed: None,
            age_s: 0.0,
            due_s: 0.0,
            path: 0.0,
        }
    }

    /// One tick with what the laws do not explain, rad, the variance of its noise, and the path of the laws since the last tick.
    pub fn step(
        &mut self,
        config: &PeriodicConfig,
        residual: &Vector2<f64>,
        variance: f64,
        moved: f64,
        dt_s: f64,
    ) {
        if !config.enabled {
            return;
        }
        self.age_s += dt_s;
        self.due_s += dt_s;
        self.path += moved;
        if self.due_s < BREATH.period_s - 1e-9 {
            return;
        }
        let dt_s = std::mem::take(&mut self.due_s);
        let path = std::mem::take(&mut self.path);
        let keep = (-dt_s / config.memory_s).exp();
        let mut jumped = true;
        for one in &mut self.bank {
            one.predict(config, path, dt_s);
            let (cost, outlier) = one.correct(residual, variance);
            one.cost = one.cost * keep + BREATH.independent * cost;
            jumped &= outlier;
        }
        if jumped {
            // neither a breath nor a drift: what was before says nothing about what follows
            self.restart(config, residual);
        }
        let mut best = 1;
        for k in 2..self.bank.len() {
            if self.bank[k].cost < self.bank[best].cost {
                best = k;
            }
        }
        let lead = self.bank[0].cost - self.bank[best].cost;
        let bar = self.believed.map_or(config.believed, |_| 0.0);
        let worth = self.bank[best].amplitude() > BREATH.worth_rad && self.age_s > BREATH.first_s;
        self.believed = (lead > bar && worth).then(|| {
            let enough = self.bank[best].cost + BREATH.better;
            let now = self.believed.filter(|&k| self.bank[k].cost < enough);
            now.unwrap_or(best)
        });
    }

    /// Begins anew: nothing is known but that the laws leave this residual, rad.
    pub fn restart(&mut self, config: &PeriodicConfig, residual: &Vector2<f64>) {
        *self = Self::new(config);
        for one in &mut self.bank {
            (one.states[0][0], one.states[1][0]) = (residual.x, residual.y);
        }
    }

    /// Whether it has taken in nothing yet.
    pub fn is_new(&self) -> bool {
        self.age_s == 0.0
    }

    /// Frequency that is believed, Hz.
    pub fn hertz(&self) -> Option<f64> {
        self.believed.map(|k| self.bank[k].rate_rad_s / TAU)
    }

    /// The disturbance in `ahead_s`, rad, and its rate, rad/s; zero where none is believed.
    pub fn at(&self, ahead_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (mut bend, mut rate) = (Vector2::zeros(), Vector2::zeros());
        let Some(one) = self.believed.map(|k| &self.bank[k]) else {
            return (bend, rate);
        };
        for axis in 0..2 {
            for k in 0..HARMONICS {
                let omega = one.rate_rad_s * (k + 1) as f64;
                let (sin, cos) = (omega * ahead_s).sin_cos();
                let (a, b) = (one.states[axis][1 + 2 * k], one.states[axis][2 + 2 * k]);
                bend[axis] += cos * a + sin * b;
                rate[axis] += omega * (cos * b - sin * a);
            }
        }
        (bend, rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    const DT_S: f64 = 0.02;
    const NOISE_RAD: f64 = 0.002;

    /// A minute with a disturbance of this amplitude and frequency on an offset that wanders.
    fn minute(seed: u64, amplitude: f64, hertz: f64) -> (Periodic, f64) {
        let (config, mut dice) = (PeriodicConfig::default(), StdRng::seed_from_u64(seed));
        let mut periodic = Periodic::new(&config);
        let mut offset = Vector2::zeros();
        let mut worst: f64 = 0.0;
        let of = |t: f64| Vector2::new(amplitude, 0.5 * amplitude) * (TAU * hertz * t).sin();
        for k in 0..3000 {
            let t = f64::from(k) * DT_S;
            let mut draw =
                |size: f64| Vector2::from_fn(|_, _| size * (dice.random::<f64>() - 0.5) * 3.46);
            offset += draw(2e-4);
            let residual = offset + of(t) + draw(NOISE_RAD);
            periodic.step(&config, &residual, NOISE_RAD * NOISE_RAD, 0.0, DT_S);
            if t > 40.0 {
                worst = worst.max((periodic.at(0.1).0 - of(t + 0.1)).norm());
            }
        }
        (periodic, worst)
    }

    #[test]
    fn a_breath_is_found_and_foreseen() {
        for (seed, hertz) in [(1, 0.2), (2, 0.27), (3, 0.33), (4, 0.45)] {
            let amplitude = 0.03 + 0.01 * seed as f64;
            let (periodic, worst) = minute(seed, amplitude, hertz);
            assert!(periodic.hertz().is_some(), "{hertz} Hz");
            assert!(
                worst < 0.25 * amplitude,
                "{hertz} Hz: {worst} of {amplitude} rad"
            );
        }
    }

    /// A jump and a ramp of a second, such as a fault makes, at drawn sizes and times.
    #[test]
    fn a_jump_is_no_breath() {
        let config = PeriodicConfig::default();
        for seed in 0..20 {
            let (mut dice, mut periodic) = (StdRng::seed_from_u64(seed), Periodic::new(&config));
            let (size, at_s) = (
                0.05 + 0.3 * dice.random::<f64>(),
                3.0 + 8.0 * dice.random::<f64>(),
            );
            let over_s = 0.02;
            for k in 0..1500 {
                let t = f64::from(k) * DT_S;
                let noise =
                    Vector2::from_fn(|_, _| NOISE_RAD * (dice.random::<f64>() - 0.5) * 3.46);
                let jump = Vector2::new(1.0, 0.4) * size * ((t - at_s) / over_s).clamp(0.0, 1.0);
                periodic.step(&config, &(jump + noise), NOISE_RAD * NOISE_RAD, 0.0, DT_S);
                assert!(
                    periodic.hertz().is_none(),
                    "{seed}: {size:.2} rad at {at_s:.1} s, believed at {t:.1} s"
                );
            }
        }
    }

    #[test]
    fn a_wandering_offset_is_no_breath() {
        let alarms = (10..40)
            .filter(|&seed| minute(seed, 0.0, 0.3).0.hertz().is_some())
            .count();
        println!("{alarms} of 30 minutes");
        assert_eq!(alarms, 0);
    }
}
