//! 95 % intervals of the part of a gap that is closed.
//!
//! Blocks of the log are drawn with replacement (block bootstrap: Künsch 1989), which says how much the
//! figure depends on what the log happens to hold. A fresh log holds another schedule, and a law of
//! another form than the truth's leaves another part of it unexplained; that is not in the blocks of one
//! log. Both act on what is *left*, `1 − closed`, by a factor, so the interval is built on its logarithm.

use crate::diagnosis::search::HeldOut;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Standard deviation of the logarithm of what is left, from one log of a unit to the next: 0.44 on the single
/// effects of `retroflex gap exam` with seeds 201 and 202, 0.45 on logs of another simulator.
const BETWEEN_LOGS: f64 = 0.45;
/// What is left is at least this, of the gap: below, the floor is not known well enough.
const LEFT_MIN: f64 = 0.01;
/// Draws of the bootstrap.
const DRAWS: usize = 400;

/// What is compared: energies before and after, and the whole gap, block by block.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    /// Without the effect.
    pub before: &'a HeldOut,
    /// With it.
    pub after: &'a HeldOut,
    /// The nominal model.
    pub nominal: &'a HeldOut,
    /// Energy of noise alone, deg².
    pub floor: f64,
}

/// The interval around `value`, the closed part on the whole log.
#[must_use]
pub fn closed_ci95(c: &Compared<'_>, value: f64, seed: u64) -> [f64; 2] {
    let n = c.before.blocks.len().min(c.after.blocks.len()).min(c.nominal.blocks.len());
    if n == 0 {
        return [value, value];
    }
    let left = (1.0 - value).max(LEFT_MIN);
    let mut rng = StdRng::seed_from_u64(seed);
    let square: f64 = (0..DRAWS)
        .map(|_| {
            let (mut b, mut a, mut whole) = (0.0, 0.0, -c.floor);
            for _ in 0..n {
                let i = rng.random_range(0..n);
                b += c.before.blocks[i];
                a += c.after.blocks[i];
                whole += c.nominal.blocks[i];
            }
            let closed = if whole > 0.0 { (b - a) / whole } else { value };
            ((1.0 - closed).max(LEFT_MIN) / left).ln().powi(2)
        })
        .sum();
    // an effect that closes nothing leaves the same on every log
    let between = BETWEEN_LOGS * value.clamp(0.0, 1.0);
    let half = 1.96 * (square / DRAWS as f64 + between * between).sqrt();
    let least = left * (-half).exp();
    [(1.0 - left * half.exp()).max(-1.0), if least < LEFT_MIN { 1.0 } else { (1.0 - least).max(value).min(1.0) }]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(blocks: &[f64]) -> HeldOut {
        HeldOut { rmse_deg: [0.0; 4], blocks: blocks.to_vec(), residual: Default::default() }
    }

    #[test]
    fn the_value_lies_inside_and_uneven_blocks_widen() {
        let (even, after) = (held(&[1.0; 20]), held(&[0.1; 20]));
        let uneven = held(&std::array::from_fn::<f64, 20, _>(|i| if i % 5 == 0 { 0.5 } else { 0.0 }));
        let ci = |after: &HeldOut| closed_ci95(&Compared { before: &even, after, nominal: &even, floor: 0.0 }, 0.9, 1);
        let (a, b) = (ci(&after), ci(&uneven));
        assert!(a[0] < 0.9 && a[1] > 0.9 && a[1] <= 1.0, "{a:?}");
        assert!(b[0] < a[0], "{b:?} {a:?}");
    }

    #[test]
    fn nothing_closed_is_nothing_closed() {
        let even = held(&[1.0; 20]);
        let ci = closed_ci95(&Compared { before: &even, after: &even, nominal: &even, floor: 0.0 }, 0.0, 1);
        assert!(ci[0].abs() < 1e-9 && ci[1].abs() < 1e-9, "{ci:?}");
    }
}
