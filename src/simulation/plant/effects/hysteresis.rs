//! Rate-independent memory of rubber: many plies that yield one after another.
//!
//! `q − h (1 + η x/√(1 + x²)) Σ μⱼ eⱼ` with `x = q / 3 mm`. Ply `j` holds a strain `eⱼ` that follows `q` between
//! `−κ ρⱼ` and `ρⱼ` and yields there: the limit is lower when the bellow contracts. The yields `ρⱼ` form a
//! geometric ladder with lognormal weights `μⱼ` around the typical one; `η` makes loops wider when the bellow
//! is long, so that loops of one width at two places are not congruent, which no sum of play operators
//! reproduces.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.hysteresis]`
    Hysteresis at "effects.hysteresis" sized by share; background 0.006; drawn by rng, severity {
        /// Share h of the motion that the plies take up until they yield. Default 0 (none); typical 0.1
        /// to 0.6, which makes loops 5 to 30 % of the range wide. A larger value gives wider loops.
        share: f64 = 0.0, 0.0..=0.75, "beyond 0.75 the bellow would move backwards", draw rng.sized(0.15, 0.55, severity);
        /// Typical yield strain, mm of bellow. Default 1. A larger value needs longer reversals to cross the
        /// loop.
        yield_mm: f64 = 1.0, 0.01..=10.0, "around 1 mm is typical", draw rng.between(0.6, 1.6);
        /// Spread of the yields, standard deviation of their logarithm. Default 0.7. A larger value rounds the
        /// loop.
        spread: f64 = 0.7, 0.05..=2.0, "0.7 is typical", draw rng.between(0.5, 0.9);
        /// Yield on the way back as a share of that on the way out, κ. Default 0.8. Further from 1
        /// shifts the loop aside.
        back: f64 = 0.8, 0.1..=2.0, "1 yields alike both ways", draw rng.between(0.7, 1.1);
        /// How much wider loops are on the long side, η. Default 0.25. A larger value differs more.
        long_side: f64 = 0.25, -0.3..=0.3, "0.25 is typical", draw rng.between(0.0, 0.3);
    }
    /// Plies of the three bellows with their strains.
    Plies runs config {
        yield_mm: [f64; PLIES] = ladder().map(|x| config.yield_mm * x.exp());
        weight: [f64; PLIES] = {
            let raw = ladder().map(|x| (-0.5 * (x / config.spread).powi(2)).exp());
            let sum: f64 = raw.iter().sum();
            raw.map(|w| w / sum)
        };
        strain_mm: [[f64; PLIES]; 3] = [[0.0; PLIES]; 3];
        last_mm: Vector3<f64> = Vector3::zeros();
    }
}

/// Number of plies.
const PLIES: usize = 11;
/// Largest over typical yield, and typical over smallest.
const REACH: f64 = 8.0;
/// Length change over which the long side's extra width comes, mm.
const LONG_MM: f64 = 3.0;

/// Logarithms of the yields over the typical one.
fn ladder() -> [f64; PLIES] {
    std::array::from_fn(|j| REACH.ln() * (2.0 * j as f64 / (PLIES - 1) as f64 - 1.0))
}

impl Law for Plies {
    fn bellows(&mut self, q_mm: &mut Vector3<f64>, _at: &Moment) {
        let (c, moved) = (&self.config, *q_mm - self.last_mm);
        self.last_mm = *q_mm;
        for i in 0..3 {
            let mut taken = 0.0;
            for j in 0..PLIES {
                let (strain_mm, yield_mm) = (&mut self.strain_mm[i][j], self.yield_mm[j]);
                *strain_mm = (*strain_mm + moved[i]).clamp(-c.back * yield_mm, yield_mm);
                taken += self.weight[j] * *strain_mm;
            }
            let x = q_mm[i] / LONG_MM;
            q_mm[i] -= c.share * (1.0 + c.long_side * x / (1.0 + x * x).sqrt()) * taken;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(plies: &mut Plies, path: &[f64]) -> Vec<f64> {
        let mut at = plies.last_mm.x;
        path.iter()
            .map(|&to| {
                let n = 400;
                let from = at;
                at = to;
                let mut left = |mm: f64| {
                    let mut q_mm = Vector3::repeat(mm);
                    plies.bellows(
                        &mut q_mm,
                        &Moment {
                            t: 0.0,
                            dt_s: 0.001,
                        },
                    );
                    q_mm.x
                };
                (1..=n)
                    .map(|k| left(from + (to - from) * f64::from(k) / f64::from(n)))
                    .last()
                    .unwrap()
            })
            .collect()
    }

    fn plies() -> Plies {
        Plies::new(Hysteresis {
            share: 0.4,
            ..Hysteresis::default()
        })
    }

    #[test]
    fn loops_close_and_are_wide() {
        let mut p = plies();
        let cycle = [5.0, 0.0, -5.0, 0.0];
        let (first, second, third) = (
            run(&mut p, &cycle),
            run(&mut p, &cycle),
            run(&mut p, &cycle),
        );
        assert!(
            (first[0] - second[0]).abs() < 0.2
                && second.iter().zip(&third).all(|(a, b)| (a - b).abs() < 1e-9)
        );
        let width = third[1] - third[3];
        assert!((0.4..1.5).contains(&width), "{width}");
    }

    #[test]
    fn a_larger_loop_wipes_out_a_minor_one() {
        let plain = run(&mut plies(), &[5.0, -5.0, 3.0]);
        let nested = run(&mut plies(), &[5.0, -5.0, 1.0, -1.0, 3.0]);
        assert!((plain[2] - nested[4]).abs() < 1e-9);
    }

    #[test]
    fn equal_loops_at_two_places_are_not_congruent() {
        let mut p = plies();
        let width = |p: &mut Plies, at: f64| {
            let y = run(p, &[at - 1.0, at + 1.0, at, at - 1.0, at]);
            y[2] - y[4]
        };
        assert!(width(&mut p, 4.0) > 1.2 * width(&mut p, -4.0));
    }
}
