//! Tooth error of rack and pinion.
//!
//! Cause: eccentric cutting and profile error make the rack lead and lag once a tooth; a rack of
//! module `M` has the pitch `p = π M` (transmission error: Smith, *Gear Noise and Vibration*, 2nd ed.
//! 2003, ch. 2).
//!
//! Law: `u_i = ũ_i + A_i sin(2πũ_i/p) + B_i (cos(2πũ_i/p) − 1)`: amplitude and phase as two numbers in
//! which the law is linear; the −1 makes the error zero at the start.
//!
//! | parameter | unit | prior | typical |
//! |---|---|---|---|
//! | `sin` A, `cos` B, one per channel | mm | 0 ± 0.15 | 0.02-0.3 |
//! | `pitch` p | mm | π ± 0.1 (module 1) | π |
//!
//! Signature: an error that repeats with piston position, whatever the speed. Similar to a
//! disturbance periodic in time, `hysteresis` of small loops and `motor_field` (which follows the
//! motors too, but in the magnetometer alone). Two speeds separate it.

use crate::model::effects::prelude::*;
use std::f64::consts::{PI, TAU};

/// Periodic transmission error of the three racks.
pub struct GearPeriodic;

impl Effect for GearPeriodic {
    info! {
        name: "gear_periodic",
        stage: Stage::Drive,
        signature: "an error periodic in piston position, not in time",
        confused_with: &["hysteresis", "motor_field"],
        separated_by: "the same travel at two speeds",
        params: &join::<7>(&[
            &Param::new("sin", "mm", 0.0, 0.15, (-0.7, 0.7)).each(),
            &Param::new("cos", "mm", 0.0, 0.15, (-0.7, 0.7)).each(),
            &[Param::new("pitch", "mm", PI, 0.1, (1.4, 6.5))],
        ]),
        // Modules 1 and 0.5: a fit does not move from one pitch to the other.
        starts: &[
            &[0.03, 0.03, 0.03, 0.03, 0.03, 0.03, PI],
            &[0.03, 0.03, 0.03, 0.03, 0.03, 0.03, PI / 2.0],
        ],
    }
    fn pistons(&self, p: &[f64], _m: &mut Memory, _at: &Moment, u_mm: &mut Vector3<f64>) {
        for i in 0..3 {
            let (sin, cos) = (TAU * u_mm[i] / p[6]).sin_cos();
            u_mm[i] += p[i] * sin + p[3 + i] * (cos - 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::tests::proof;

    #[test]
    fn is_consistent() {
        proof::is_consistent(&GearPeriodic);
    }

    #[test]
    fn a_fit_recovers_it() {
        proof::is_recovered(&GearPeriodic, &[0.2, -0.1, 0.15, -0.1, 0.2, 0.05, 3.16]);
    }

    #[test]
    fn the_error_repeats_with_position_at_any_speed() {
        let p = proof::with(&GearPeriodic, &[("sin", 0.2), ("cos", -0.1)]);
        let error = |speed: f64, u: f64| {
            let run = proof::drive(&GearPeriodic, &p, u / speed, |t| Vector3::repeat(speed * t));
            let last = run.last().expect("a drive has samples");
            last.u_mm - Vector3::repeat(speed * last.t_s)
        };
        for u in [0.6, 1.2, 2.4] {
            assert!(
                (error(1.0, u) - error(4.0, u)).norm() < 1e-9,
                "speed must not matter"
            );
            assert!(
                (error(1.0, u) - error(1.0, u + 0.5 * PI)).norm() > 0.1,
                "half a tooth further it differs"
            );
        }
        let at = |u: f64| {
            let mut v = Vector3::repeat(u);
            GearPeriodic.pistons(&p, &mut Memory::default(), &proof::moment(0.0, v), &mut v);
            v.x - u
        };
        for k in 0..20 {
            let u = 0.37 * f64::from(k);
            assert!((at(u) - at(u + PI)).abs() < 1e-12);
        }
    }
}
