//! The air spring stiffens with pressure.
//!
//! Cause: air at absolute pressure `p₀ + p` takes the volume Boyle's law gives it,
//! `(p₀ + p)(V₀ − ΔV) = p₀ V₀`, so `ΔV = V₀ p/(p₀ + p)` where the nominal model has `V₀ p/p₀`
//! (Beater, *Pneumatic Drives*, 2007, ch. 3). A bellow of stiffness k and area A has `p = k q/A`.
//!
//! Law: `w = q + k_ε q/(1 + c q)` with `c = k/(A p₀)`, one over the length change that one more
//! atmosphere makes. Its root is the one that tends to `w/(1 + k_ε)`:
//! `q = 2w/(B + √(B² + 4cw))`, `B = 1 + k_ε − c w`; the play output is scaled so that the nominal extension
//! after it gives this q.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `boyle` c | 1/mm | 0 ± 0.04 | 0.01-0.08 (5-30 % of gain at 5 mm) |
//!
//! Signature: the gain grows with pressure and falls under vacuum: an even-order curve, alike in the
//! three channels, without a corner. Similar to `asymmetry` (a corner at zero, different for each
//! bellow) and `stiffening` (odd). A pressure signal or common-mode length changes separate it.

use crate::model::effects::prelude::*;

/// Boyle's law in place of a linear air spring.
pub struct GasCompression;

impl Effect for GasCompression {
    info! {
        name: "gas_compression",
        stage: Stage::Transmission,
        signature: "gain grows with pressure and falls under vacuum: an even-order curve without a corner",
        confused_with: &["asymmetry", "stiffening", "crosstalk"],
        separated_by: "a pressure signal; common-mode length changes",
        params: &[Param::new("boyle", "1/mm", 0.0, 0.04, (-0.05, 0.25))],
    }
    fn play_output(&self, p: &[f64], _m: &mut Memory, at: &Moment, w_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            let full = 1.0 + at.k_epsilon[i];
            let b = full - p[0] * w_mm[i];
            // 4 k_ε + (cw + 1 − k_ε)² for any gain above zero; the lower bound is for gains below
            let root = (b * b + 4.0 * p[0] * w_mm[i]).max(0.0).sqrt();
            w_mm[i] *= 2.0 * full / (b + root).max(0.1 * full);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&GasCompression);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&GasCompression, &[0.06]);
    }

    #[test]
    fn bellow_and_air_share_the_piston_as_boyle_says() {
        let c = 0.05;
        let run = proof::drive(&GasCompression, &[c], 90.0, proof::exercise);
        let k = proof::moment(0.0, Vector3::zeros()).k_epsilon;
        for l in run {
            for i in 0..3 {
                let w = l.q_mm[i] + k[i] * l.q_mm[i] / (1.0 + c * l.q_mm[i]);
                assert!((w - l.u_mm[i]).abs() < 1e-9, "{l:?}");
            }
        }
    }

    #[test]
    fn gain_grows_with_pressure() {
        let gain = |w: f64| {
            proof::drive(&GasCompression, &[0.05], 0.0, |_| Vector3::repeat(w))[0]
                .w_mm
                .x
                / w
        };
        assert!(gain(15.0) > 1.1 && gain(-15.0) < 0.9);
        let (up, down) = (gain(3.0) - 1.0, 1.0 - gain(-3.0));
        assert!(
            (up / down - 1.0).abs() < 0.2,
            "even to first order: {up} {down}"
        );
    }
}
