//! Small memories that several stages keep: an exact first-order decay, coloured noise, a delay line.

use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// `1 − e^(−dt/τ)`, kept as long as the caller's step stays the same.
///
/// A first-order lag held over `dt` moves by exactly this share of its distance, whatever `dt` is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Decay {
    tau_s: f64,
    dt_s: f64,
    share: f64,
}

impl Decay {
    /// With time constant `tau_s`; 0 follows at once.
    pub(crate) fn new(tau_s: f64) -> Self {
        Self { tau_s, dt_s: f64::NAN, share: 1.0 }
    }
    /// The share of the distance covered in `dt_s`.
    pub(crate) fn share(&mut self, dt_s: f64) -> f64 {
        if dt_s != self.dt_s {
            self.dt_s = dt_s;
            self.share = if self.tau_s > 0.0 { -(-dt_s / self.tau_s).exp_m1() } else { 1.0 };
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
    /// Starts at a typical value, not at zero.
    pub(crate) fn new(sigma: f64, tau_s: f64, rng: &mut PlantRng) -> Self {
        Self { sigma, decay: Decay::new(tau_s), x: rng.normals() * sigma }
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

/// Past values by time, linear in between. Its store is set aside once and never grows.
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
    /// Reaching `reach_s` back at steps of `step_min_s` or more; `rest` held since ever.
    pub(crate) fn new(reach_s: f64, step_min_s: f64, rest: T) -> Self {
        let mut past = VecDeque::with_capacity((reach_s / step_min_s).ceil() as usize + 4);
        past.push_back((f64::NEG_INFINITY, rest));
        past.push_back((0.0, rest));
        Self { reach_s, past }
    }
    /// Notes the value at time `t`, later than any before.
    pub(crate) fn push(&mut self, t: f64, value: T) {
        if self.past.len() == self.past.capacity() {
            self.past.pop_front();
        }
        self.past.push_back((t, value));
        while self.past.len() > 2 && self.past[1].0 < t - self.reach_s {
            self.past.pop_front();
        }
    }
    /// The value at time `t`, up to the reach ago.
    pub(crate) fn at(&self, t: f64) -> T {
        // never empty: it starts with two values and keeps at least two
        let next = self.past.partition_point(|&(s, _)| s < t - 1e-12).clamp(1, self.past.len() - 1);
        let ((s1, before), (s2, after)) = (self.past[next - 1], self.past[next]);
        let gap = s2 - s1;
        if gap.is_finite() && gap > 0.0 { before.mix(&after, ((t - s1) / gap).clamp(0.0, 1.0)) } else { after }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::plant::rng::Stream;

    #[test]
    fn a_decay_does_not_care_for_the_step() {
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
    fn wander_has_the_spread_it_was_given() {
        let mut rng = PlantRng::new(3, Stream::TipImu);
        let mut w = Wander::new(2.0, 0.1, &mut rng);
        let n = 20_000;
        let square: f64 = (0..n).map(|_| w.step(0.05, &mut rng).norm_squared() / 3.0).sum::<f64>() / f64::from(n);
        assert!((square.sqrt() - 2.0).abs() < 0.06, "{}", square.sqrt());
    }

    #[test]
    fn a_delay_gives_back_the_past_without_growing() {
        let mut d = Delay::new(0.05, 0.001, Vector3::zeros());
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
