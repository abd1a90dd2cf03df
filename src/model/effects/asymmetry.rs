//! Elongation and contraction of a bellow differ.
//!
//! Cause: a bellow opened by pressure and one folded by vacuum are two springs: a material or
//! structure of two moduli (Jones, *Stress-strain relations for materials with different moduli in
//! tension and compression*, AIAA J. 1977).
//!
//! Law: `q′_i = q_i + a_i (√(q_i² + ε²) − ε)`: slope 1 + a for long, 1 − a for short, rounded over
//! ε = 0.3 mm.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `difference` a, one per channel | – | 0 ± 0.1 | 0.03-0.2 (5-40 % between the slopes) |
//!
//! Signature: the slope changes at zero. Similar to `gas_compression` (no corner, the same in
//! all channels) and, in orientation alone, `crosstalk` to both neighbours. Amplitudes of both signs and an
//! offset of length, which shifts the corner, separate it.

use crate::model::effects::prelude::*;

/// Rounding of the corner, mm.
const EDGE_MM: f64 = 0.3;

/// A corner at rest in each bellow's curve.
pub struct Asymmetry;

impl Effect for Asymmetry {
    info! {
        name: "asymmetry",
        stage: Stage::Bellows,
        signature: "slope of a channel changes at zero",
        confused_with: &["gas_compression", "crosstalk"],
        separated_by: "amplitudes of both signs, with the length offset",
        params: &Param::new("difference", "", 0.0, 0.1, (-0.6, 0.6)).each(),
        starts: &[&[0.02; 3]],
    }
    fn bellows(&self, p: &[f64], _m: &mut Memory, _at: &Moment, q_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            q_mm[i] += p[i] * magnitude(q_mm[i], EDGE_MM);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Asymmetry);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Asymmetry, &[0.2, -0.1, 0.1]);
    }

    #[test]
    fn slopes_differ_on_the_two_sides_and_only_there() {
        let at = |q: f64| {
            let mut v = Vector3::repeat(q);
            Asymmetry.bellows(
                &[0.2, 0.0, -0.2],
                &mut Memory::default(),
                &proof::moment(0.0, v),
                &mut v,
            );
            v
        };
        let slope = |q: f64| (at(q + 0.01) - at(q - 0.01)) / 0.02;
        assert!((slope(4.0) - Vector3::new(1.2, 1.0, 0.8)).norm() < 2e-3);
        assert!((slope(-4.0) - Vector3::new(0.8, 1.0, 1.2)).norm() < 2e-3);
        assert!(
            (slope(4.0) - slope(2.0)).norm() < 5e-3,
            "linear beyond the corner"
        );
    }
}
