//! 95 % intervals of the part of a gap that is closed.
//!
//! A block bootstrap (Künsch 1989) gives the spread due to the contents of the log. A fresh log has another schedule,
//! and a law that differs from the true one leaves another part of it unexplained; one log cannot show that spread, so
//! a constant is added. Both spreads scale the part that is *left*, `1 − closed`; the interval is formed on its
//! logarithm.

use crate::diagnosis::tip::fit::HeldOut;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Standard deviation of the logarithm of what is left from one log of a unit to the next: 0.44 on the single effects
/// of `retroflex gap exam` with seeds 201 and 202, 0.45 on logs of another simulator.
const BETWEEN_LOGS: f64 = 0.45;
/// Least part of the gap that is left: the noise is not known more precisely.
const LEFT_MIN: f64 = 0.01;
/// Draws of the bootstrap.
const DRAWS: usize = 400;

/// Scores that are compared.
#[derive(Debug, Clone, Copy)]
pub struct Compared<'a> {
    /// Without the effect.
    pub before: &'a HeldOut,
    /// With the effect.
    pub after: &'a HeldOut,
    /// Nominal model.
    pub nominal: &'a HeldOut,
    /// Energy of noise alone, deg².
    pub floor: f64,
}

/// The interval around `value`, the closed part on the whole log.
pub fn closed_ci95(c: &Compared<'_>, value: f64, seed: u64) -> [f64; 2] {
    let [before, after, nominal] = [c.before, c.after, c.nominal].map(|h| h.blocks.as_slice());
    let n = before.len().min(after.len()).min(nominal.len());
    if n == 0 {
        return [value, value];
    }
    let left = (1.0 - value).max(LEFT_MIN);
    let mut rng = StdRng::seed_from_u64(seed);
    let draw = |_| {
        let (mut without, mut with, mut gap) = (0.0, 0.0, -c.floor);
        for _ in 0..n {
            let i = rng.random_range(0..n);
            without += before[i];
            with += after[i];
            gap += nominal[i];
        }
        let closed = if gap > 0.0 {
            (without - with) / gap
        } else {
            value
        };
        ((1.0 - closed).max(LEFT_MIN) / left).ln().powi(2)
    };
    let square: f64 = (0..DRAWS).map(draw).sum();
    // an effect that closes nothing leaves the same on every log
    let between = BETWEEN_LOGS * value.clamp(0.0, 1.0);
    let half = 1.96 * (square / DRAWS as f64 + between * between).sqrt();
    let least = left * (-half).exp();
    let high = match least < LEFT_MIN {
        true => 1.0,
        false => (1.0 - least).max(value).min(1.0),
    };
    [(1.0 - left * half.exp()).max(-1.0), high]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(blocks: &[f64]) -> HeldOut {
        HeldOut {
            rmse_deg: Default::default(),
            blocks: blocks.to_vec(),
            residual: Default::default(),
            density: Default::default(),
        }
    }

    #[test]
    fn the_interval_contains_the_value_and_uneven_blocks_widen_it() {
        let (even, after) = (held(&[1.0; 20]), held(&[0.1; 20]));
        let uneven = held(&std::array::from_fn::<f64, 20, _>(|i| {
            if i % 5 == 0 { 0.5 } else { 0.0 }
        }));
        let ci = |after: &HeldOut| {
            closed_ci95(
                &Compared {
                    before: &even,
                    after,
                    nominal: &even,
                    floor: 0.0,
                },
                0.9,
                1,
            )
        };
        let (a, b) = (ci(&after), ci(&uneven));
        assert!(a[0] < 0.9 && a[1] > 0.9 && a[1] <= 1.0, "{a:?}");
        assert!(b[0] < a[0], "{b:?} {a:?}");
    }

    #[test]
    fn an_effect_that_closes_nothing_has_an_interval_of_zero_width() {
        let even = held(&[1.0; 20]);
        let ci = closed_ci95(
            &Compared {
                before: &even,
                after: &even,
                nominal: &even,
                floor: 0.0,
            },
            0.0,
            1,
        );
        assert!(ci[0].abs() < 1e-9 && ci[1].abs() < 1e-9, "{ci:?}");
    }
}
