//! Viscoelastic relaxation of the rubber during holds.
//!
//! Cause: polymer chains continue to slide under a constant load. Law: two Kelvin-Voigt elements in
//! series with the elastic one (Findley, Lai and Onaran, *Creep and Relaxation of Nonlinear
//! Viscoelastic Materials*, 1976, ch. 5),
//! `q′ = q + c_f z_f + c_s z_s`, `τ ż_f = q − z_f`, `12 τ ż_s = q − z_s`. Two elements a decade apart
//! approximate the log t or power law of real rubber over the two decades that a log covers.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `fast` c_f | – | 0 ± 0.08 | 0.02-0.2 |
//! | `slow` c_s | – | 0 ± 0.08 | 0.02-0.2 |
//! | `tau` τ | s | 2 ± 2 | 0.5-10 |
//!
//! Signature: holds drift so that the motion grows, and after the return it recovers. Easily confused
//! with `leak` (drifts the other way and does not recover), `line_lag` (ends within a second or two),
//! `thermal_drift` (follows the clock) and `hysteresis`. Hold, return, hold separates it.

use crate::model::effects::prelude::*;

/// Time constant of the slow element over that of the fast one.
const DECADE: f64 = 12.0;

/// Two Kelvin-Voigt elements, the same for each bellow.
pub struct Creep;

impl Effect for Creep {
    info! {
        name: "creep",
        stage: Stage::Bellows,
        signature: "drift in holds that grows the motion and recovers after the return",
        confused_with: &["leak", "line_lag", "thermal_drift", "hysteresis"],
        separated_by: "hold, return, hold",
        params: &[
            Param::new("fast", "", 0.0, 0.08, (0.0, 0.8)),
            Param::new("slow", "", 0.0, 0.08, (0.0, 0.8)),
            Param::new("tau", "s", 2.0, 2.0, (0.3, 20.0)),
        ],
        starts: &[&[0.04, 0.04, 1.0], &[0.04, 0.04, 6.0]],
    }
    /// Memory holds the two elements of each bellow.
    fn bellows(&self, p: &[f64], m: &mut Memory, at: &Moment, q_mm: &mut Vector3<f64>) {
        let (fast, slow) = (share(at.dt_s / p[2]), share(at.dt_s / (DECADE * p[2])));
        for i in 0..3 {
            m.0[i] += (q_mm[i] - m.0[i]) * fast;
            m.0[3 + i] += (q_mm[i] - m.0[3 + i]) * slow;
            q_mm[i] += p[0] * m.0[i] + p[1] * m.0[3 + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&Creep);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&Creep, &[0.06, 0.15, 3.5]);
    }

    #[test]
    fn a_hold_grows_the_motion_and_the_return_recovers() {
        let p = proof::with(&Creep, &[("fast", 0.1), ("slow", 0.1)]);
        let run = proof::drive(&Creep, &p, 300.0, |t| {
            Vector3::repeat(if t < 60.0 { 10.0 } else { 0.0 })
        });
        let q = |t_s: usize| run[t_s * 100].q_mm.x;
        assert!(q(1) < q(10) && q(10) < q(50), "grows through the hold");
        assert!((q(50) / q(0) - 1.2).abs() < 0.03, "{}", q(50) / q(0));
        assert!(
            q(61) > 0.3 && q(61) > q(80) && q(80) > q(200),
            "same sign after the return, then less"
        );
        assert!(q(299).abs() < 0.01, "{}", q(299));
    }
}
