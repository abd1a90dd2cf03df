//! Times, counted in buckets that grow with them: eight to the octave, so a percentile is known to
//! about 9 %. Fixed size, no allocation, cheap enough for every step.

/// Buckets to the octave.
const PER_OCTAVE: usize = 8;
/// Octaves from 128 ns: the last bucket begins at 134 ms.
const OCTAVES: usize = 20;
/// Shortest time that is resolved, as a power of two of nanoseconds.
const FLOOR_LOG2: usize = 7;
/// Number of buckets: one below the floor, the octaves and one above.
pub const BUCKETS: usize = PER_OCTAVE * OCTAVES + 2;

/// Histogram of durations in ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Histogram {
    buckets: [u32; BUCKETS],
    count: u64,
    sum_ns: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { buckets: [0; BUCKETS], count: 0, sum_ns: 0, max_ns: 0 }
    }
}

impl Histogram {
    /// Counts one duration.
    #[inline]
    pub fn record(&mut self, ns: u64) {
        let bucket = &mut self.buckets[bucket_of(ns)];
        *bucket = bucket.saturating_add(1);
        self.count += 1;
        self.sum_ns = self.sum_ns.saturating_add(ns);
        self.max_ns = self.max_ns.max(ns);
    }

    /// How many were counted.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The longest, ns, exactly.
    #[must_use]
    pub fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// The mean, ns, exactly; 0 when nothing was counted.
    #[must_use]
    pub fn mean_ns(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum_ns as f64 / self.count as f64 }
    }

    /// The duration that a share `q` (0 to 1) of all did not exceed, ns: the upper edge of its
    /// bucket, and at most the longest. 0 when nothing was counted.
    #[must_use]
    pub fn quantile_ns(&self, q: f64) -> u64 {
        let rank = (q.clamp(0.0, 1.0) * self.count as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (i, &n) in self.buckets.iter().enumerate() {
            seen += u64::from(n);
            if seen >= rank {
                return edge_ns(i + 1).min(self.max_ns);
            }
        }
        self.max_ns
    }

    /// Lower and upper edge, ns, and number of every bucket that is not empty, in order.
    pub fn filled(&self) -> impl Iterator<Item = (u64, u64, u32)> + '_ {
        self.buckets.iter().enumerate().filter(|(_, n)| **n > 0).map(|(i, &n)| (edge_ns(i), edge_ns(i + 1), n))
    }
}

/// The bucket of a duration.
fn bucket_of(ns: u64) -> usize {
    if ns < 1 << FLOOR_LOG2 {
        return 0;
    }
    let octave = ns.ilog2() as usize;
    let part = ((ns >> (octave - 3)) & 7) as usize;
    ((octave - FLOOR_LOG2) * PER_OCTAVE + part + 1).min(BUCKETS - 1)
}

/// Lower edge of a bucket, ns; beyond the last it is the end of time.
fn edge_ns(bucket: usize) -> u64 {
    match bucket {
        0 => 0,
        b if b >= BUCKETS => u64::MAX,
        b => {
            let (octave, part) = ((b - 1) / PER_OCTAVE + FLOOR_LOG2, (b - 1) % PER_OCTAVE);
            ((PER_OCTAVE + part) as u64) << (octave - 3)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every duration lies in its bucket, and buckets resolve 12.5 % or better.
        #[test]
        fn buckets_hold_what_they_say(ns in 0u64..200_000_000) {
            let b = bucket_of(ns);
            prop_assert!(edge_ns(b) <= ns && ns < edge_ns(b + 1), "{ns} {b}");
            if ns >= 128 && b < BUCKETS - 1 {
                prop_assert!((edge_ns(b + 1) - edge_ns(b)) as f64 <= 0.1251 * edge_ns(b) as f64);
            }
        }

        /// A quantile is never below the true one, and at most a bucket above.
        #[test]
        fn quantiles_bracket_the_truth(mut times in prop::collection::vec(128u64..10_000_000, 1..300), q in 0.0..1.0f64) {
            let mut h = Histogram::default();
            times.iter().for_each(|&t| h.record(t));
            times.sort_unstable();
            let rank = ((q * times.len() as f64).ceil().max(1.0) as usize) - 1;
            let (truth, told) = (times[rank], h.quantile_ns(q));
            prop_assert!(told >= truth && told as f64 <= 1.126 * truth as f64, "{truth} {told}");
        }
    }

    #[test]
    fn empty_says_zero() {
        let h = Histogram::default();
        assert_eq!((h.quantile_ns(0.99), h.max_ns(), h.count()), (0, 0, 0));
    }
}
