//! Random numbers of the plant: one portable generator, one stream per use.
//!
//! Every use has a stream of its own, so that an effect never shifts the noise of the sensors: two plants with
//! the same seed differ by the effect and by nothing else.

use nalgebra::Vector3;
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Use of the random numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Stream {
    TipImu = 1,
    BaseImu,
    GyroBias,
    TransportDelay,
    SensorLatency,
    Unit,
    Choice,
}

/// A seeded source of random numbers.
#[derive(Debug, Clone)]
pub(crate) struct PlantRng(Xoshiro256PlusPlus);

impl PlantRng {
    pub(crate) fn new(seed: u64, stream: Stream) -> Self {
        // an odd multiplier maps streams to seeds one to one; seed_from_u64 mixes them apart
        let stream = (stream as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        Self(Xoshiro256PlusPlus::seed_from_u64(seed ^ stream))
    }
    /// Standard normal.
    pub(crate) fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }
    /// Three independent standard normals.
    pub(crate) fn normals(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }
    /// A direction in space, uniformly distributed.
    pub(crate) fn direction(&mut self) -> Vector3<f64> {
        let direction = self.normals().try_normalize(1e-9);
        direction.unwrap_or_else(Vector3::x)
    }
    /// Uniform in `low..high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }
    /// −1 or 1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
    /// True with probability `p`.
    pub(crate) fn chance(&mut self, p: f64) -> bool {
        self.0.random::<f64>() < p
    }
    /// A channel, 1 to 3.
    pub(crate) fn channel(&mut self) -> usize {
        self.0.random_range(1..=3)
    }
    /// An angle in −180..180 degrees.
    pub(crate) fn angle_deg(&mut self) -> f64 {
        self.between(-180.0, 180.0)
    }
    /// A size between the ends of a typical range, geometric in `severity` 0..=1, within ±10 %.
    pub(crate) fn sized(&mut self, low: f64, high: f64, severity: f64) -> f64 {
        low * (high / low).powf(severity.clamp(0.0, 1.0)) * self.between(0.9, 1.1)
    }
    /// A factor around 1 whose logarithm has the standard deviation `sigma`.
    pub(crate) fn factor(&mut self, sigma: f64) -> f64 {
        (sigma * self.normal()).exp()
    }
    /// `size` on one channel (mostly), or on all three within ±20 %.
    pub(crate) fn on_channels(&mut self, size: f64) -> [f64; 3] {
        let only = self.channel() - 1;
        let all = self.chance(0.35);
        let others = [(); 3].map(|()| size * self.between(0.8, 1.2) * f64::from(all));
        std::array::from_fn(|i| if i == only { size } else { others[i] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_and_are_reproducible() {
        let draw = |seed, stream| PlantRng::new(seed, stream).normal();
        assert_eq!(draw(7, Stream::TipImu), draw(7, Stream::TipImu));
        assert_ne!(draw(7, Stream::TipImu), draw(7, Stream::BaseImu));
        assert_ne!(draw(7, Stream::TipImu), draw(8, Stream::TipImu));
    }

    #[test]
    fn drawn_sizes_stay_near_their_range() {
        let mut rng = PlantRng::new(1, Stream::Choice);
        for k in 0..200 {
            let x = rng.sized(0.1, 10.0, f64::from(k) / 199.0);
            assert!((0.09..11.0).contains(&x));
        }
    }
}
