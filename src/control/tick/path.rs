//! Following a reference that moves: the set-point, and the pistons ahead of their lag.

use super::setpoint::SetPoint;
use super::state::LoopState;
use super::types::{LoopConfig, Reference};
use crate::control::follow::{Follower, Pace};
use crate::control::limits::{ActuatorLimits, Cut};
use crate::model::{Bend, Geometry, Shape, SideState};
use crate::motion::{MotionLimits, MotionState, Stop};
use crate::primitives::Mm;
use nalgebra::{Vector1, Vector2, Vector3};

/// Motion of the play output that the crossing of a backlash may cost, mm.
const CROSSING_COST_MM: f64 = 0.03;
/// Shortest and longest crossing, s: a piston needs the first from rest to rest.
const CROSSING_S: (f64, f64) = (0.08, 0.4);
/// Part of a crossing in which the piston starts and stops, s.
const STARTING_S: f64 = 0.05;
/// Speed of a play output below which its direction is not a new one, mm/s.
const TURN_MM_S: f64 = 0.3;
/// Ratio of the acceleration with which the set-point catches up with the reference to the pace's, or to the reference's if
/// that is greater.
const CATCH_UP: f64 = 2.0;

/// Moves the set-point onto the reference. Where the two differ, their difference is brought to zero within the pace; so a
/// reference that jumps moves the tip no faster than a target does.
pub(super) fn advance(
    config: &LoopConfig,
    state: &mut LoopState,
    reference: &Reference,
    pace: &Pace,
    dt_s: f64,
) -> Cut {
    let (reference, cut) = within_reach(&config.limits, &config.geometry, reference);
    let setpoint = &mut state.setpoint;
    let at = reference.shape.bend.0;
    let behind = setpoint.bend.at - (at - reference.rate * dt_s);
    let mut difference = Follower {
        at: behind,
        velocity: setpoint.bend.velocity - reference.rate,
    };
    let acceleration = CATCH_UP * pace.acceleration.max(reference.acceleration.norm());
    difference.step(
        &Vector2::zeros(),
        &Pace {
            acceleration,
            ..*pace
        },
        dt_s,
    );
    // catching up takes no more than the pace either
    let before = setpoint.bend.at;
    setpoint.bend = Follower {
        at: before + (at + difference.at - before).cap_magnitude(pace.speed * dt_s),
        velocity: (reference.rate + difference.velocity).cap_magnitude(pace.speed),
    };
    setpoint.target = reference.shape;
    setpoint.target_rests_s = 0.0;
    setpoint.acceleration = Some(reference.acceleration);
    setpoint.length.step(
        &Vector1::new(reference.shape.length.0),
        &config.length_pace,
        dt_s,
    );
    cut
}

/// The reference within the range of the bellows; at its border it moves along the border only.
fn within_reach(
    limits: &ActuatorLimits,
    geometry: &Geometry,
    reference: &Reference,
) -> (Reference, Cut) {
    let (q_mm, cut) = limits.bellows(&geometry.lengths(&reference.shape), geometry.rest_length_mm);
    if cut == Cut::None {
        return (*reference, cut);
    }
    let shape = geometry.shape(&q_mm);
    let outward = shape.bend.0.try_normalize(1e-9).unwrap_or_default();
    let along = |v: Vector2<f64>| v - outward * v.dot(&outward).max(0.0);
    (
        Reference {
            shape,
            rate: along(reference.rate),
            acceleration: along(reference.acceleration),
        },
        cut,
    )
}

/// Velocity and acceleration of the bellow lengths, mm/s and mm/s², for a command that leads the set-point by `lead_s`;
/// `None` without a reference that moves.
pub(super) fn bellow_motion(
    config: &LoopConfig,
    setpoint: &SetPoint,
    lead_s: f64,
) -> Option<[Vector3<f64>; 2]> {
    let acceleration = setpoint.acceleration.filter(|_| !setpoint.has_arrived())?;
    let length = Mm(config.geometry.rest_length_mm);
    let lengths = |v: Vector2<f64>| {
        config.geometry.lengths(&Shape {
            bend: Bend(v),
            length,
        })
    };
    Some([
        lengths(setpoint.bend.velocity + acceleration * lead_s),
        lengths(acceleration),
    ])
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
    let &Passing {
        w_mm,
        speed,
        acceleration,
    } = passing;
    let crossing_s = (2.0 * (2.0 * CROSSING_COST_MM / acceleration.abs().max(1e-9)).sqrt())
        .clamp(CROSSING_S.0, CROSSING_S.1);
    let heading = speed + acceleration * crossing_s / 2.0;
    let direction = if heading.abs() > TURN_MM_S || before.direction == 0.0 {
        heading.signum()
    } else {
        before.direction
    };
    let most = 2.0 * dt_s / (crossing_s - STARTING_S);
    let next = SideState {
        w_mm,
        side: before.side + (direction - before.side).clamp(-most, most),
        direction,
    };
    let velocity_mm_s = speed.clamp(-limits.speed_max_mm_s, limits.speed_max_mm_s);
    let position_mm = w_mm + half_width_mm * next.side;
    (
        Stop::from(
            MotionState {
                position_mm,
                velocity_mm_s,
                acceleration_mm_s2: 0.0,
            },
            limits,
        )
        .end_mm,
        next,
    )
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
