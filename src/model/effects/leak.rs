//! A line slowly loses the air that the piston displaced.
//!
//! Cause: a seam or fitting passes a laminar flow in proportion to the pressure across it,
//! `ṁ = −C p` (Beater, *Pneumatic Drives*, 2007, ch. 4). The pressure is that of the stretched
//! bellow, hence in proportion to the play output.
//!
//! Law: `ȯ_i = −C_i s_i`, `s_i = w_i + o_i`: `w` play output, `o` air lost so far
//! (as piston travel), `s` air left. Under vacuum the rate is `ρ C_i`, because vacuum may close a lip that
//! pressure opens.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `rate` C, one per channel | 1/s | 0 ± 0.01 | 10⁻⁵-10⁻¹ |
//! | `vacuum_ratio` ρ | – | 1 ± 0.5 | 0.2-2 |
//!
//! Signature: decay towards rest in holds, then an offset the other way after the return. Similar to
//! `creep` (opposite sign, recovers) and `thermal_drift` (follows the clock). Long holds
//! at two pressures and a return to zero separate it.

use crate::model::effects::prelude::*;

/// Play output over which pressure turns into vacuum, mm.
const EDGE_MM: f64 = 0.5;

/// Loss of air in proportion to pressure.
pub struct Leak;

impl Effect for Leak {
    info! {
        name: "leak",
        stage: Stage::Transmission,
        signature: "decay towards rest in holds, in proportion to pressure, then an offset the other way",
        confused_with: &["creep", "thermal_drift", "missed_steps"],
        separated_by: "long holds at two pressures, then a return to zero",
        params: &join::<4>(&[
            &Param::new("rate", "1/s", 0.0, 0.01, (0.0, 0.3)).each(),
            &[Param::new("vacuum_ratio", "", 1.0, 0.5, (0.0, 4.0))],
        ]),
        starts: &[&[0.003, 0.003, 0.003, 1.0], &[0.03, 0.03, 0.03, 1.0]],
    }
    fn play_output(&self, p: &[f64], m: &mut Memory, at: &Moment, w_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            let left_mm = w_mm[i] + m.0[i];
            let side = sign(left_mm, EDGE_MM);
            let rate = p[i] * 0.5 * ((1.0 + side) + p[3] * (1.0 - side));
            m.0[i] -= left_mm * share(at.dt_s * rate);
            w_mm[i] += m.0[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Leak);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Leak, &[0.012, 0.0004, 0.03, 0.6]);
    }

    /// Held at `w_mm` for 100 s, then back at zero: what is left just before and just after.
    fn hold(w_mm: f64, vacuum_ratio: f64) -> (f64, f64) {
        let p = proof::with(&Leak, &[("rate", 0.005), ("vacuum_ratio", vacuum_ratio)]);
        let run = proof::drive(&Leak, &p, 101.0, |t| {
            Vector3::repeat(if t < 100.0 { w_mm } else { 0.0 })
        });
        (run[9_999].w_mm.x, run[10_000].w_mm.x)
    }

    #[test]
    fn air_is_lost_in_proportion_and_stays_lost() {
        let (held, back) = hold(10.0, 1.0);
        assert!((held - 10.0 * (-0.5f64).exp()).abs() < 0.01, "{held}");
        assert!(
            (back - (held - 10.0)).abs() < 0.01,
            "the return leaves an offset the other way: {back}"
        );
        let (half, _) = hold(5.0, 1.0);
        assert!((half / held - 0.5).abs() < 1e-3);
    }

    #[test]
    fn a_lip_that_vacuum_closes_leaks_less() {
        let (pressed, _) = hold(10.0, 0.2);
        let (sucked, _) = hold(-10.0, 0.2);
        assert!(
            (pressed - 6.06).abs() < 0.02 && (-sucked - 9.05).abs() < 0.05,
            "{pressed} {sucked}"
        );
    }
}
