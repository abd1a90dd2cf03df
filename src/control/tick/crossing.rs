//! The inverse of a backlash under a reference that moves: where a piston passes, and when it crosses.

use crate::control::path::RUN_UP_S;
use crate::model::SideState;
use crate::motion::{MotionLimits, MotionState, Stop};

/// Shortest crossing, s: a piston needs it from rest to rest.
pub(super) const CROSSING_MIN_S: f64 = 0.08;

crate::constants! {
    /// The crossing of a backlash.
    const CROSSING: CrossingConstants;
    /// Motion of the play output that it may cost, mm.
    cost_mm = 0.03;
    /// Part of it in which the piston starts and stops, s.
    starting_s = 0.05;
    /// Speed of a play output below which its direction is not a new one, mm/s.
    turn_mm_s = 0.3;
}

/// A play output on its direction: position in mm, speed and acceleration of the reference in mm/s and mm/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Passing {
    pub(super) w_mm: f64,
    pub(super) speed: f64,
    pub(super) acceleration: f64,
}

/// Piston target for a play output that passes `w_mm` while the reference has this velocity and acceleration.
///
/// The side of the backlash follows the reference alone: a reversal by feedback that crosses an overestimated backlash moves
/// the tip too far, and the feedback would reverse again. The crossing is centred on the turning point, and the slower the
/// reference turns, the more time it takes; so the feedback can act on a backlash that is smaller than expected.
///
/// Because a piston is sent to its target to stop there, the target is where a piston that passes the wanted position with
/// the wanted speed would come to rest.
pub(super) fn invert(
    half_width_mm: f64,
    before: SideState,
    passing: &Passing,
    limits: &MotionLimits,
    dt_s: f64,
) -> (f64, SideState) {
    let turn_s = (2.0 * CROSSING.cost_mm / passing.acceleration.abs().max(1e-9)).sqrt();
    let crossing_s = (2.0 * turn_s).clamp(CROSSING_MIN_S, RUN_UP_S);
    let heading = passing.speed + passing.acceleration * crossing_s / 2.0;
    let direction = if heading.abs() > CROSSING.turn_mm_s || before.direction == 0.0 {
        heading.signum()
    } else {
        before.direction
    };
    let most = 2.0 * dt_s / (crossing_s - CROSSING.starting_s);
    let next = SideState {
        w_mm: passing.w_mm,
        side: before.side + (direction - before.side).clamp(-most, most),
        direction,
    };
    let speed_max = limits.speed_max_mm_s;
    let passes = MotionState {
        position_mm: passing.w_mm + half_width_mm * next.side,
        velocity_mm_s: passing.speed.clamp(-speed_max, speed_max),
        acceleration_mm_s2: 0.0,
    };
    (Stop::from(passes, limits).end_mm, next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piston_crosses_its_backlash_before_the_play_output_turns_and_does_not_chatter() {
        let limits = MotionLimits::default();
        let (dt_s, rate) = (0.001, 2.0 * std::f64::consts::PI * 0.2);
        let (mut side, mut turned) = (SideState::default(), Vec::new());
        for k in 0..10_000 {
            let t = f64::from(k) * dt_s;
            let (sin, cos) = (rate * t).sin_cos();
            // 10 µm of noise on the bellow, as feedback makes it
            let q_mm = 2.0 * sin + 0.01 * f64::from(k * 7919 % 13 - 6) / 6.0;
            let passing = Passing {
                w_mm: 3.0 * q_mm,
                speed: 6.0 * rate * cos,
                acceleration: -6.0 * rate * rate * sin,
            };
            let (_, next) = invert(1.0, side, &passing, &limits, dt_s);
            if next.direction != side.direction {
                turned.push(t);
            }
            side = next;
        }
        // the sine of 0.2 Hz turns at 1.25, 3.75, 6.25 and 8.75 s
        assert_eq!(turned.len(), 5, "{turned:?}");
        for (t, turns) in turned[1..].iter().zip([1.25, 3.75, 6.25, 8.75]) {
            assert!(t < &turns && *t > turns - 0.15, "{t} {turns}");
        }
    }

    #[test]
    fn a_piston_that_passes_is_sent_to_where_it_would_stop() {
        let limits = MotionLimits::default();
        let passing = Passing {
            w_mm: 3.0,
            speed: 15.0,
            acceleration: 0.0,
        };
        let (target, _) = invert(
            1.0,
            SideState {
                w_mm: 3.0,
                side: 1.0,
                direction: 1.0,
            },
            &passing,
            &limits,
            0.001,
        );
        // 15 mm/s stop within half of (15/600 + 600/30000) s
        assert!(
            (target - (3.0 + 1.0 + 15.0 * 0.0225)).abs() < 1e-3,
            "{target}"
        );
    }
}
