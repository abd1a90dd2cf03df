//! Target and set-point of the loop.

use crate::control::follow::{Follower, Pace};
use crate::model::Shape;
use nalgebra::{Vector1, Vector2};

/// Target and set-point: bend in rad, length in mm.
#[derive(Debug, Clone)]
pub(super) struct SetPoint {
    pub(super) target: Shape,
    /// Time since the last target, s.
    pub(super) target_rests_s: f64,
    pub(super) bend: Follower<2>,
    /// Acceleration of the reference that the set-point follows, rad/s²; `None` for a target.
    pub(super) acceleration: Option<Vector2<f64>>,
    /// Acceleration limit of the present motion, rad/s².
    pub(super) brake: f64,
    pub(super) length: Follower<1>,
}

impl SetPoint {
    pub(super) fn resting(at: Shape) -> Self {
        let length = Follower::resting(Vector1::new(at.length.0));
        Self {
            target: at,
            target_rests_s: f64::INFINITY,
            bend: Follower::resting(at.bend.0),
            acceleration: None,
            brake: 0.0,
            length,
        }
    }

    /// `pace` with the acceleration of the present motion for as long as the bend is faster than `pace` permits or could not stop
    /// at the target with it: a target with a slower pace is not overshot.
    pub(super) fn brake(&mut self, pace: &Pace) -> Pace {
        let speed = self.bend.velocity.norm();
        let to_go = (self.target.bend.0 - self.bend.at).norm();
        if speed <= pace.speed && speed.powi(2) <= 2.0 * pace.acceleration * to_go {
            self.brake = pace.acceleration;
        }
        Pace {
            acceleration: self.brake.max(pace.acceleration),
            ..*pace
        }
    }

    pub(super) fn has_arrived(&self) -> bool {
        let stands = self.bend.velocity == Vector2::zeros();
        stands
            && self.bend.arrived(&self.target.bend.0)
            && self.length.arrived(&Vector1::new(self.target.length.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Bend;
    use crate::primitives::Mm;

    /// The target stays and its pace falls to `share` after `change_s`: neither sooner nor later may the set-point pass it.
    #[test]
    fn a_slower_pace_in_mid_motion_does_not_overshoot() {
        let dt_s = 1.0 / 200.0;
        for share in [0.5, 0.1, 0.01, 0.001] {
            for change_s in [0.05, 0.2, 0.4, 0.6, 0.7] {
                let fast = Pace {
                    speed: 1.5,
                    acceleration: 10.0,
                };
                let slow = Pace {
                    speed: fast.speed * share,
                    acceleration: fast.acceleration * share,
                };
                let mut setpoint = SetPoint::resting(Shape {
                    bend: Bend::STRAIGHT,
                    length: Mm(10.0),
                });
                setpoint.target.bend = Bend(Vector2::new(1.0, 0.0));
                let mut furthest: f64 = 0.0;
                for k in 0..1600 {
                    let pace = setpoint.brake(if f64::from(k) * dt_s < change_s {
                        &fast
                    } else {
                        &slow
                    });
                    setpoint.bend.step(&setpoint.target.bend.0, &pace, dt_s);
                    furthest = furthest.max(setpoint.bend.at.x);
                }
                assert!(
                    furthest <= 1.0 + 1e-3,
                    "{share} after {change_s} s: {furthest}"
                );
                assert!(setpoint.bend.velocity.norm() <= slow.speed + 1e-9);
            }
        }
    }
}
