//! Viscous flow through the lumen, beyond the mechanical lag τ₀.
//!
//! Cause: a long thin line of resistance R feeds the compliance C of the bellow, `τ = RC` (Schuder
//! and Binder, *The response of pneumatic transmission lines to step inputs*, J. Basic Eng. 1959).
//! Filling drives denser air through the line than draining, so the two may differ.
//!
//! The line has a volume of its own, which fills first: of its poles beyond the slowest, together 6 % of the delay where line and
//! bellow hold as much air and 19 % where the line holds nearly all, one stands for all.
//!
//! Law: `b τ_i(1 + a s) ẏ_i = w_i − y_i` and `(1 − b) τ_i(1 + a s) ż_i = y_i − z_i`, s the sign of `w_i − z_i`: `z` play output at the
//! bellow's end, `a` the difference of filling (+) and draining (−), `b` the share of the line.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `tau` τ, one per channel | s | 0 ± 0.2 | 0.05-1 |
//! | `fill_drain` a | – | 0 ± 0.3 | −0.4-0.4 |
//! | `line_share` b | – | 0.08 ± 0.08 | 0-0.3 |
//!
//! Signature: error in proportion to speed, gone in holds within seconds. Similar to
//! `transport_delay` (no rounding), play and `creep` (slower). Steps and a chirp separate it.

use crate::model::effects::prelude::*;

/// Gap over which filling turns into draining, mm.
const EDGE_MM: f64 = 0.05;

/// Lag of each line: first order, rounded off by the air in the line itself.
pub struct LineLag;

impl Effect for LineLag {
    info! {
        name: "line_lag",
        stage: Stage::Transmission,
        signature: "error in proportion to speed that rounds off steps and is gone within seconds of a hold",
        confused_with: &["transport_delay", "sensor_latency", "creep", "hysteresis"],
        separated_by: "steps and a chirp",
        params: &join::<5>(&[
            &Param::new("tau", "s", 0.0, 0.2, (0.0, 3.0)).each(),
            &[
                Param::new("fill_drain", "", 0.0, 0.3, (-0.9, 0.9)),
                Param::new("line_share", "", 0.08, 0.08, (0.0, 0.5)),
            ],
        ]),
        starts: &[&[0.08, 0.08, 0.08, 0.0, 0.08], &[0.4, 0.4, 0.4, 0.0, 0.08]],
    }
    /// Memory holds where the far end of each line stands, then its air.
    fn play_output(&self, p: &[f64], m: &mut Memory, at: &Moment, w_mm: &mut Vector3<f64>) {
        let (fill_drain, line_share) = (p[3], p[4]);
        let (ends, airs) = m.0.split_at_mut(3);
        for i in 0..3 {
            let (end, air) = (&mut ends[i], &mut airs[i]);
            let tau_s = p[i] * (1.0 + fill_drain * sign(w_mm[i] - *end, EDGE_MM));
            let [kept_air, kept_end] = [line_share, 1.0 - line_share]
                .map(|share| share * tau_s / (share * tau_s + at.dt_s));
            *air = w_mm[i] + (*air - w_mm[i]) * kept_air;
            *end = *air + (*end - *air) * kept_end;
            w_mm[i] = *end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&LineLag);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&LineLag, &[0.3, 0.1, 0.6, -0.3, 0.2]);
    }

    #[test]
    fn a_step_arrives_with_its_time_constant() {
        let p = proof::with(&LineLag, &[("tau", 0.4)]);
        let run = proof::drive(&LineLag, &p, 10.0, |t| {
            Vector3::repeat(if t > 0.0 { 8.0 } else { 0.0 })
        });
        assert!(
            (run[40].w_mm.y - 8.0 * (1.0 - (-1.0f64).exp())).abs() < 0.06,
            "{}",
            run[40].w_mm.y
        );
        assert!((run[1000].w_mm.y - 8.0).abs() < 1e-6, "a hold has no error");
    }

    #[test]
    fn a_ramp_lags_by_tau_and_draining_may_be_faster() {
        let p = proof::with(&LineLag, &[("tau", 0.4), ("fill_drain", 0.5)]);
        let behind = |speed: f64| {
            let run = proof::drive(&LineLag, &p, 10.0, |t| Vector3::repeat(speed * t));
            let last = run.last().expect("a drive has samples");
            (last.u_mm.x - last.w_mm.x) / speed
        };
        assert!((behind(5.0) - 0.6).abs() < 0.001, "{}", behind(5.0));
        assert!((behind(-5.0) - 0.2).abs() < 0.001, "{}", behind(-5.0));
    }
}
