//! Progressive stiffness of the bellow's wall.
//!
//! Cause: folds flatten and rubber chains straighten, so the force grows faster than the stretch, in
//! both directions alike: `F = k₁q + k₃q³` (Duffing 1918; rubber: Treloar, *The Physics of Rubber
//! Elasticity*, 3rd ed. 1975).
//!
//! Law: the bellow takes the part of the linear length change `q` that satisfies `q′ (1 + a_i (q′/L)²) = q`
//! with L = 5 mm, so `a` is the extra stiffness at 5 mm. The cubic has one real root for a ≥ 0, found by
//! Newton steps from above.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `extra` a, one per channel | – | 0 ± 0.15 | 0.05-0.4 |
//!
//! Signature: an odd static curve of each channel. With equal `a` and constant length it bends like
//! `curvature` of third order. Also similar to `gas_compression` (even). An amplitude ladder at two
//! lengths separates it.

use crate::model::effects::prelude::*;

/// Length change at which `extra` is the extra stiffness, mm.
const REACH_MM: f64 = 5.0;
/// Newton steps; from above the root of a convex cubic they converge for every start.
const STEPS: usize = 5;

/// Odd stiffening of each bellow.
pub struct Stiffening;

impl Effect for Stiffening {
    info! {
        name: "stiffening",
        stage: Stage::Bellows,
        signature: "an odd static curve of each channel: large moves fall short, both ways alike",
        confused_with: &["curvature", "gas_compression", "softening"],
        separated_by: "an amplitude ladder at two lengths",
        params: &Param::new("extra", "", 0.0, 0.15, (0.0, 1.5)).each(),
    }
    fn bellows(&self, p: &[f64], _m: &mut Memory, _at: &Moment, q_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            q_mm[i] = root(q_mm[i], p[i] / (REACH_MM * REACH_MM));
        }
    }
}

/// Root of `x + κx³ = q`.
fn root(q: f64, kappa: f64) -> f64 {
    let mut x = q;
    for _ in 0..STEPS {
        let bent = kappa * x * x;
        x -= (x + bent * x - q) / (1.0 + 3.0 * bent);
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Stiffening);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Stiffening, &[0.3, 0.1, 0.2]);
    }

    #[test]
    fn the_cubic_is_solved_and_odd() {
        for a in [0.05, 0.4, 1.5] {
            let kappa = a / (REACH_MM * REACH_MM);
            for q in [0.3, 2.0, 6.0, 9.0] {
                let x = root(q, kappa);
                assert!((x + kappa * x.powi(3) - q).abs() < 1e-4 * q, "{a} {q} {x}");
                assert!((root(-q, kappa) + x).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn large_moves_fall_short_more_than_small_ones() {
        let gain = |w: f64| {
            proof::drive(&Stiffening, &[0.3; 3], 0.0, |_| Vector3::repeat(w))[0]
                .q_mm
                .x
                * 3.22
                / w
        };
        assert!(
            gain(1.0) > 0.998 && gain(16.0) < 0.85,
            "{} {}",
            gain(1.0),
            gain(16.0)
        );
    }
}
