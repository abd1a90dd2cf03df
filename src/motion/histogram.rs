//! A histogram of durations with eight buckets per octave, so that percentiles are known to about 9 %.
//! It has a fixed size, does not allocate, and is cheap enough for every step.

/// Buckets per octave.
const PER_OCTAVE: usize = 8;
/// Octaves from 128 ns on: the last bucket begins at 134 ms.
const OCTAVES: usize = 20;
/// Shortest duration with a bucket of its own, as a power of two of nanoseconds.
const SHORTEST_LOG2: usize = 7;
/// Number of buckets: one below the shortest duration, the octaves, and one above.
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
        Self {
            buckets: [0; BUCKETS],
            count: 0,
            sum_ns: 0,
            max_ns: 0,
        }
    }
}

impl Histogram {
    /// Counts one duration.
    pub fn record(&mut self, ns: u64) {
        let bucket = &mut self.buckets[bucket_of(ns)];
        *bucket = bucket.saturating_add(1);
        self.count += 1;
        self.sum_ns = self.sum_ns.saturating_add(ns);
        self.max_ns = self.max_ns.max(ns);
    }

    /// Number of durations.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The exact maximum, ns.
    pub fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// The exact mean, ns; 0 if the histogram is empty.
    pub fn mean_ns(&self) -> f64 {
        // the sum of an empty histogram is 0
        self.sum_ns as f64 / self.count.max(1) as f64
    }

    /// The duration that a share `q` (0 to 1) of all durations does not exceed, ns: the upper edge of
    /// its bucket, but at most the maximum. 0 if the histogram is empty.
    pub fn quantile_ns(&self, q: f64) -> u64 {
        let rank = (q.clamp(0.0, 1.0) * self.count as f64).ceil().max(1.0) as u64;
        let mut below = 0;
        for (i, &n) in self.buckets.iter().enumerate() {
            below += u64::from(n);
            if below >= rank {
                return edge_ns(i + 1).min(self.max_ns);
            }
        }
        self.max_ns
    }
}

/// The bucket of a duration. Within an octave, the three bits below the leading one are its number.
fn bucket_of(ns: u64) -> usize {
    if ns < 1 << SHORTEST_LOG2 {
        return 0;
    }
    let octave = ns.ilog2() as usize;
    let part = ((ns >> (octave - 3)) & 7) as usize;
    ((octave - SHORTEST_LOG2) * PER_OCTAVE + part + 1).min(BUCKETS - 1)
}

/// Lower edge of a bucket, ns. The last bucket has no upper edge.
fn edge_ns(bucket: usize) -> u64 {
    match bucket {
        0 => 0,
        b if b >= BUCKETS => u64::MAX,
        b => {
            let (octave, part) = ((b - 1) / PER_OCTAVE + SHORTEST_LOG2, (b - 1) % PER_OCTAVE);
            ((PER_OCTAVE + part) as u64) << (octave - 3)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_duration_lies_in_its_bucket_and_buckets_resolve_an_eighth(ns in 0u64..200_000_000) {
            let b = bucket_of(ns);
            prop_assert!(edge_ns(b) <= ns && ns < edge_ns(b + 1), "{ns} {b}");
            if ns >= 128 && b < BUCKETS - 1 {
                prop_assert!((edge_ns(b + 1) - edge_ns(b)) as f64 <= 0.1251 * edge_ns(b) as f64);
            }
        }

        #[test]
        fn a_quantile_is_at_most_one_bucket_above_the_exact_one(
            mut times in prop::collection::vec(128u64..10_000_000, 1..300), q in 0.0..1.0f64,
        ) {
            let mut h = Histogram::default();
            times.iter().for_each(|&t| h.record(t));
            times.sort_unstable();
            let rank = ((q * times.len() as f64).ceil().max(1.0) as usize) - 1;
            let (exact, reported) = (times[rank], h.quantile_ns(q));
            prop_assert!(reported >= exact && reported as f64 <= 1.126 * exact as f64, "{exact} {reported}");
        }
    }

    #[test]
    fn an_empty_histogram_is_all_zero() {
        let h = Histogram::default();
        assert_eq!((h.quantile_ns(0.99), h.max_ns(), h.count()), (0, 0, 0));
    }
}
