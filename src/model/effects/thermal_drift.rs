//! Slow offset as the air in syringes and lines warms.
//!
//! Cause: motors and body heat warm the trapped air towards a steady temperature (Newton's law of
//! cooling: Incropera et al., *Fundamentals of Heat and Mass Transfer*, 6th ed. 2007, ch. 5); at
//! nearly constant pressure its volume grows in proportion.
//!
//! Law: `w_i += a_i (1 − e^(−t/τ))`, t since the start.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `size` a, one per channel | mm of piston | 0 ± 0.8 | 0.1-1.6 (0.5-7°) |
//! | `tau` τ | s | 60 ± 60 | 20-300 |
//!
//! Signature: depends on the time since the start, not on the command. Similar to `creep`
//! (follows the command), `leak` (follows the pressure), `gyro_bias` (gyroscope only) and
//! `base_motion`. An idle hold and a repeated pose separate it. Orientation does not depend on the part that
//! lengthens all bellows alike, sizes in proportion to 1 + k_ε: the prior determines it.

use crate::model::effects::prelude::*;

/// Warming of the three lines towards a steady state.
pub struct ThermalDrift;

impl Effect for ThermalDrift {
    info! {
        name: "thermal_drift",
        stage: Stage::Transmission,
        signature: "a slow offset that depends on the time since the start, not on the command",
        confused_with: &["creep", "leak", "gyro_bias", "base_motion"],
        separated_by: "an idle hold; a pose repeated late",
        params: &join::<4>(&[
            &Param::new("size", "mm", 0.0, 0.8, (-6.0, 6.0)).each(),
            &[Param::new("tau", "s", 60.0, 60.0, (5.0, 900.0))],
        ]),
        starts: &[&[0.1, 0.0, -0.1, 30.0], &[0.1, 0.0, -0.1, 120.0]],
    }
    fn play_output(&self, p: &[f64], _m: &mut Memory, at: &Moment, w_mm: &mut Vector3<f64>) {
        let warm = -(-at.t_s / p[3]).exp_m1();
        *w_mm += Vector3::new(p[0], p[1], p[2]) * warm;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&ThermalDrift);
    }

    #[test]
    fn a_fit_recovers_it_except_for_the_length() {
        let truth = [1.5, -0.6, 0.8, 75.0];
        let found = proof::fitted(&ThermalDrift, &truth);
        assert!((found[3] - truth[3]).abs() < 1.0, "{found:?}");
        let off = Vector3::from_fn(|i, _| found[i] - truth[i]);
        let length = proof::moment(0.0, Vector3::zeros())
            .k_epsilon
            .add_scalar(1.0);
        assert!(
            off.cross(&length).norm() < 0.02,
            "{found:?}: wrong by more than a common length"
        );
    }

    #[test]
    fn the_offset_depends_on_time_and_not_on_the_command() {
        let p = proof::with(&ThermalDrift, &[("size", 1.5), ("tau", 20.0)]);
        let still = proof::drive(&ThermalDrift, &p, 100.0, |_| Vector3::zeros());
        let moved = proof::drive(&ThermalDrift, &p, 100.0, proof::exercise);
        for (s, m) in still.iter().zip(&moved) {
            assert!((s.w_mm - (m.w_mm - m.u_mm)).norm() < 1e-12);
        }
        assert!(
            still[0].w_mm.norm() == 0.0 && still[100].w_mm.x < 0.1,
            "the rest is undisturbed"
        );
        assert!((still[2000].w_mm.x - 1.5 * (1.0 - (-1.0f64).exp())).abs() < 1e-9);
        assert!((still[10_000].w_mm.x - 1.5).abs() < 0.02);
    }
}
