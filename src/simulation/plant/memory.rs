//! States that several stages share: an exact first-order decay, coloured noise, a delay line, a wandering dead time.

use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// `1 − e^(−dt/τ)`, the share of its distance that a first-order lag covers in `dt`, recomputed only when the step
/// changes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Decay {
    tau_s: f64,
    dt_s: f64,
    share: f64,
}

impl Decay {
    /// A lag of time constant `tau_s`; 0 is no lag.
    pub(crate) fn new(tau_s: f64) -> Self {
        Self {
            tau_s,
            dt_s: f64::NAN,
            share: 1.0,
        }
    }
    /// The share of the distance covered in `dt_s`.
    pub(crate) fn share(&mut self, dt_s: f64) -> f64 {
        if dt_s != self.dt_s {
            self.dt_s = dt_s;
            self.share = if self.tau_s > 0.0 {
                -(-dt_s / self.tau_s).exp_m1()
            } else {
                1.0
            };
        }
        self.share
    }
}

/// Gauss-Markov noise on three axes: standard deviation `sigma`, correlation time τ.
#[derive(Debug, Clone)]
pub(crate) struct Wander {
    sigma: f64,
    decay: Decay,
    x: Vector3<f64>,
}

impl Wander {
    /// A stationary process: its first value is a random one.
    pub(crate) fn new(sigma: f64, tau_s: f64, rng: &mut PlantRng) -> Self {
        Self {
            sigma,
            decay: Decay::new(tau_s),
            x: rng.normals() * sigma,
        }
    }
    /// The value after `dt_s` more seconds.
    pub(crate) fn step(&mut self, dt_s: f64, rng: &mut PlantRng) -> Vector3<f64> {
        if self.sigma > 0.0 {
            let kept = 1.0 - self.decay.share(dt_s);
            self.x = self.x * kept + rng.normals() * (self.sigma * (1.0 - kept * kept).sqrt());
        }
        self.x
    }
}

/// Past values by time, linear in between. Its memory is allocated once and never grows.
#[derive(Debug, Clone)]
pub(crate) struct Delay<T> {
    reach_s: f64,
    past: VecDeque<(f64, T)>,
}

/// Values between which a straight line can be drawn.
pub(crate) trait Mix: Copy {
    /// `self` at `share` 0, `other` at 1.
    fn mix(&self, other: &Self, share: f64) -> Self;
}

impl Mix for Vector3<f64> {
    fn mix(&self, other: &Self, share: f64) -> Self {
        self.lerp(other, share)
    }
}

impl<T: Mix> Delay<T> {
    /// A line that reaches `reach_s` back at steps of [`STEP_MIN_S`] or more, filled with `rest`.
    pub(crate) fn new(reach_s: f64, rest: T) -> Self {
        let mut past = VecDeque::with_capacity((reach_s / STEP_MIN_S).ceil() as usize + 4);
        past.push_back((f64::NEG_INFINITY, rest));
        past.push_back((0.0, rest));
        Self { reach_s, past }
    }
    /// Stores the value at time `t`, later than any before.
    pub(crate) fn push(&mut self, t: f64, value: T) {
        if self.past.len() == self.past.capacity() {
            self.past.pop_front();
        }
        self.past.push_back((t, value));
        while self.past.len() > 2 && self.past[1].0 < t - self.reach_s {
            self.past.pop_front();
        }
    }
    /// The value at time `t`, at most the reach ago.
    pub(crate) fn at(&self, t: f64) -> T {
        // never empty: it starts with two values and keeps at least two
        let next = self.past.partition_point(|&(s, _)| s < t - 1e-12);
        let next = next.clamp(1, self.past.len() - 1);
        let ((s1, before), (s2, after)) = (self.past[next - 1], self.past[next]);
        let gap = s2 - s1;
        if gap.is_finite() && gap > 0.0 {
            before.mix(&after, ((t - s1) / gap).clamp(0.0, 1.0))
        } else {
            after
        }
    }
}

/// A dead time that wanders: `T (1 + j x(t))`, with `x` a unit Gauss-Markov process bounded at ±2.5. Values between
/// two known times are linear.
#[derive(Debug, Clone)]
pub(crate) struct DeadTime<T> {
    delay_s: f64,
    jitter: f64,
    line: Delay<T>,
    wander: Wander,
    rng: PlantRng,
}

/// Shortest step of the caller for which memory is allocated, s.
const STEP_MIN_S: f64 = 2e-4;
/// Correlation time of the wander, s.
const WANDER_S: f64 = 1.0;
/// Bound of the wander, standard deviations.
const WANDER_MAX: f64 = 2.5;

impl<T: Mix> DeadTime<T> {
    /// A dead time of `delay_s` with relative wander `jitter`, filled with `rest`.
    pub(crate) fn new(delay_s: f64, jitter: f64, rest: T, mut rng: PlantRng) -> Self {
        let wander = Wander::new(1.0, WANDER_S, &mut rng);
        Self {
            delay_s,
            jitter,
            line: Delay::new(delay_s * (1.0 + jitter * WANDER_MAX), rest),
            wander,
            rng,
        }
    }
    /// Fills the line with `rest`.
    pub(crate) fn fill(&mut self, rest: T) {
        self.line = Delay::new(self.line.reach_s, rest);
    }
    /// Takes the value at `t` and returns the value that arrives then.
    pub(crate) fn pass(&mut self, t: f64, dt_s: f64, value: T) -> T {
        self.line.push(t, value);
        let x = self.wander.step(dt_s, &mut self.rng).x;
        let x = x.clamp(-WANDER_MAX, WANDER_MAX);
        self.line.at(t - self.delay_s * (1.0 + self.jitter * x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::plant::rng::Stream;

    fn late_by(delay_s: f64, jitter: f64, dt: f64, steps: i32) -> Vec<f64> {
        let mut d = DeadTime::new(
            delay_s,
            jitter,
            Vector3::zeros(),
            PlantRng::new(2, Stream::SensorLatency),
        );
        (1..steps)
            .map(|k| f64::from(k) * dt)
            .map(|t| t - d.pass(t, dt, Vector3::repeat(t)).x)
            .collect()
    }

    #[test]
    fn a_ramp_is_late_by_the_dead_time_at_every_step_length() {
        for dt in [0.0005, 0.001, 0.005, 0.01] {
            let late = *late_by(0.083, 0.0, dt, (0.5 / dt) as i32).last().unwrap();
            assert!((late - 0.083).abs() < 1e-9, "{dt} {late}");
        }
    }

    #[test]
    fn the_wander_is_present_and_bounded() {
        let late = late_by(0.1, 0.1, 0.002, 20_000);
        let (low, high) = late[100..]
            .iter()
            .fold((1.0f64, 0.0f64), |(l, h), &x| (l.min(x), h.max(x)));
        assert!(
            low > 0.074 && low < 0.09 && high < 0.126 && high > 0.11,
            "{low} {high}"
        );
    }

    #[test]
    fn a_decay_does_not_depend_on_the_step() {
        let (mut fine, mut coarse) = (Decay::new(0.03), Decay::new(0.03));
        let (mut a, mut b) = (0.0, 0.0);
        for k in 0..100 {
            a += (1.0 - a) * fine.share(0.001);
            if k % 10 == 9 {
                b += (1.0 - b) * coarse.share(0.01);
            }
        }
        assert!((a - b).abs() < 1e-12f64);
    }

    #[test]
    fn wander_has_the_configured_deviation() {
        let mut rng = PlantRng::new(3, Stream::TipImu);
        let mut w = Wander::new(2.0, 0.1, &mut rng);
        let n = 20_000;
        let square: f64 = (0..n)
            .map(|_| w.step(0.05, &mut rng).norm_squared() / 3.0)
            .sum::<f64>()
            / f64::from(n);
        assert!((square.sqrt() - 2.0).abs() < 0.06, "{}", square.sqrt());
    }

    #[test]
    fn a_delay_returns_past_values_without_growing() {
        let mut d = Delay::new(0.05, Vector3::zeros());
        let room = d.past.capacity();
        for k in 1..2000 {
            let t = f64::from(k) * 0.001;
            d.push(t, Vector3::repeat(t));
            assert!((d.at(t - 0.0305).x - (t - 0.0305).max(0.0)).abs() < 1e-9);
            assert!((d.at(t).x - t).abs() < 1e-12);
        }
        assert_eq!(d.past.capacity(), room);
        assert!(d.past.len() < 60);
    }
}
