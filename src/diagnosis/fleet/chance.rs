//! How probable a difference is by chance alone.

use libm::{erfc, lgamma};

/// Ranks from 1; equal values share the mean of theirs.
fn ranks(x: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let mut ranks = vec![0.0; x.len()];
    for tied in order.chunk_by(|a, b| x[*a] == x[*b]) {
        let first = order.partition_point(|k| x[*k] < x[tied[0]]);
        let rank = first as f64 + (tied.len() as f64 + 1.0) / 2.0;
        tied.iter().for_each(|k| ranks[*k] = rank);
    }
    ranks
}

/// Rank correlation (Spearman 1904) times √(n − 1): nearly standard normal if `x` and `y` are independent.
pub fn rank_z(x: &[f64], y: &[f64]) -> f64 {
    let centred = |v: &[f64]| {
        let mean = (v.len() as f64 + 1.0) / 2.0;
        ranks(v).into_iter().map(|r| r - mean).collect::<Vec<f64>>()
    };
    let (x, y) = (centred(x), centred(y));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = (dot(&x, &x) * dot(&y, &y)).sqrt();
    if norm > 0.0 {
        dot(&x, &y) / norm * (x.len() as f64 - 1.0).sqrt()
    } else {
        0.0
    }
}

/// Probability that a standard normal number is at least as far from zero.
pub fn two_sided(z: f64) -> f64 {
    erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// Probability that at least `hits` of `drawn` have what `all_hits` of `all` have (Fisher's exact test, one-sided).
pub fn at_least(hits: usize, drawn: usize, all_hits: usize, all: usize) -> f64 {
    let ln_choose = |n: usize, k: usize| {
        lgamma(n as f64 + 1.0) - lgamma(k as f64 + 1.0) - lgamma((n - k) as f64 + 1.0)
    };
    let term = |k: usize| {
        let others = drawn - k;
        if others > all - all_hits {
            0.0
        } else {
            (ln_choose(all_hits, k) + ln_choose(all - all_hits, others) - ln_choose(all, drawn))
                .exp()
        }
    };
    (hits..=drawn.min(all_hits)).map(term).sum::<f64>().min(1.0)
}
