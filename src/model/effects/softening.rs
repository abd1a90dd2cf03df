//! First stretches soften the rubber.
//!
//! Cause: chains that tear from filler particles stay torn, so the stiffness falls with the largest stretch
//! so far (Mullins, *Rubber Chem. Technol.* 1969); as a damage law (Simo, *Comput. Methods Appl.
//! Mech. Eng.* 1987) `d = 1 − e^(−M/m₀)` with M the largest |q| so far.
//!
//! Law: `q′_i = q_i [1 − s_i (1 − D_i)]`, `D_i = (1 − e^(−X_i/m₀)) (1 − κ (q_i/M_i)²)`. M_i is the largest stretch
//! so far, of which a contraction counts the share σ, and `X_i = M_i + c ∫|dq_i|` the wear: mostly the maximum, plus a little per stroke.
//! Small strain loads few chains: softening acts by the share `|q|/(|q| + t)`, t the toe of the curve.
//! Near the past maximum the virgin curve is met again (pseudo-elastic Mullins law of Ogden and Roxburgh,
//! *Proc. R. Soc. A* 1999), by the share κ. A fresh bellow moves less by the share s, a worn one according to the
//! gains, so the re-identified gains are those of the worn bellow.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `fresh` s, one per channel | – | 0 ± 0.15 | 0.05-0.6 |
//! | `reach` m₀ | mm | 2 ± 1.5 | 1-5 |
//! | `rejoin` κ | – | 0 ± 0.4 | 0-1 |
//! | `tiring` c | mm/mm | 0 ± 0.02 | 0-0.1 |
//! | `contracted` σ | – | 1 ± 0.4 | 0-1 |
//! | `toe` t | mm | 0 ± 0.4 | 0-1 |
//!
//! Signature: the curve changes only beyond the past maximum, and for good. Similar to
//! `stiffening` (does not depend on the past), `thermal_drift` and `creep` (continue inside the past
//! maximum). A rising amplitude that is then repeated separates it.

use crate::model::effects::prelude::*;

/// Damage by the largest stretch so far, the same law for each bellow.
pub struct Softening;

impl Effect for Softening {
    info! {
        name: "softening",
        stage: Stage::Bellows,
        signature: "gain changes only beyond the largest past stretch, and for good",
        confused_with: &["stiffening", "creep", "thermal_drift"],
        separated_by: "a rising amplitude, then the same again",
        params: &join::<8>(&[
            &Param::new("fresh", "", 0.0, 0.15, (0.0, 0.8)).each(),
            &[
                Param::new("reach", "mm", 2.0, 1.5, (0.3, 12.0)),
                Param::new("rejoin", "", 0.0, 0.4, (0.0, 1.0)),
                Param::new("tiring", "mm/mm", 0.0, 0.02, (0.0, 0.3)),
                Param::new("contracted", "", 1.0, 0.4, (0.0, 1.5)),
                Param::new("toe", "mm", 0.0, 0.4, (0.0, 4.0)),
            ],
        ]),
    }
    fn starts(&self) -> Starts {
        [(1.0, 0.1), (4.0, 0.1), (3.0, 0.6)]
            .map(|(reach, rejoin)| vec![0.15, 0.15, 0.15, reach, rejoin, 0.005, 0.8, 0.1])
            .to_vec()
    }
    /// Memory holds each bellow's largest stretch, from 3 on its path, from 6 on its last length change.
    fn bellows(&self, p: &[f64], m: &mut Memory, _at: &Moment, q_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            let q = q_mm[i];
            let strain = q.max(-p[6] * q);
            m.0[i] = m.0[i].max(strain);
            m.0[3 + i] += (q - m.0[6 + i]).abs();
            m.0[6 + i] = q;
            let worn = -(-(m.0[i] + p[5] * m.0[3 + i]) / p[3]).exp_m1();
            let near = if m.0[i] > 0.0 {
                (strain / m.0[i]).powi(2)
            } else {
                0.0
            };
            let toe = if p[7] > 0.0 {
                q.abs() / (q.abs() + p[7])
            } else {
                1.0
            };
            q_mm[i] *= 1.0 - p[i] * (1.0 - worn * (1.0 - p[4] * near) * toe);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Softening);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::fitted(&Softening, &[0.4, 0.35, 0.4, 2.5, 0.3, 0.01, 0.9, 0.2]);
    }

    #[test]
    fn only_a_new_maximum_changes_the_curve() {
        let p = proof::with(&Softening, &[("fresh", 0.4), ("reach", 2.0)]);
        let mut m = Memory::default();
        let mut gain = |q: f64| {
            let mut v = Vector3::repeat(q);
            Softening.bellows(&p, &mut m, &proof::moment(0.0, v), &mut v);
            v.x / q
        };
        let fresh = gain(1.0);
        assert!(
            (gain(-0.5) - fresh).abs() < 1e-12,
            "inside the past maximum nothing changes, either way"
        );
        let worn = gain(3.0);
        assert!(worn > fresh + 0.1, "{fresh} {worn}");
        assert!((gain(1.0) - worn).abs() < 1e-12, "and it stays");
        assert!((gain(-20.0) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn the_virgin_curve_is_rejoined_at_the_past_maximum_and_strokes_wear() {
        let p = proof::with(
            &Softening,
            &[
                ("fresh", 0.4),
                ("reach", 2.0),
                ("rejoin", 1.0),
                ("tiring", 0.05),
            ],
        );
        let mut m = Memory::default();
        let mut gain = |q: f64| {
            let mut v = Vector3::repeat(q);
            Softening.bellows(&p, &mut m, &proof::moment(0.0, v), &mut v);
            v.x / q
        };
        assert!(
            (gain(3.0) - 0.6).abs() < 1e-9,
            "at the maximum nothing is softened"
        );
        let inside = gain(1.0);
        assert!(inside > 0.8);
        for _ in 0..20 {
            gain(-1.0);
            gain(1.0);
        }
        assert!(gain(1.0) > inside + 1e-3);
    }
}
