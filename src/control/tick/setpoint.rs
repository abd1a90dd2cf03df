//! Target and set-point of the loop, and how the set-point moves.

use super::types::{LoopConfig, Reference};
use crate::control::follow::{Follower, Pace};
use crate::control::limits::Cut;
use crate::model::{Geometry, Shape};
use nalgebra::{Vector1, Vector2, Vector3};

/// Ratio of the acceleration with which the set-point catches up with the reference to the pace's, or to the reference's if
/// that is greater. With the default pace it is four fifths of what pistons of 600 mm/s² can with the paper's gains.
const CATCH_UP: f64 = 3.5;

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
    brake: f64,
    pub(super) length: Follower<1>,
}

impl SetPoint {
    pub(super) fn resting(at: Shape) -> Self {
        Self {
            target: at,
            target_rests_s: f64::INFINITY,
            bend: Follower::resting(at.bend.0),
            acceleration: None,
            brake: 0.0,
            length: Follower::resting(Vector1::new(at.length.0)),
        }
    }

    /// Where the set-point is.
    pub(super) fn shape(&self) -> Shape {
        Shape::new(self.bend.at, self.length.at.x)
    }

    /// Moves towards the target, which stays within the range of the bellows.
    pub(super) fn approach(&mut self, config: &LoopConfig, pace: &Pace, dt_s: f64) -> Cut {
        self.acceleration = None;
        let (target, cut) = within_reach(config, &self.target);
        self.target = target;
        let pace = self.braking(pace);
        self.bend.step(&self.target.bend.0, &pace, dt_s);
        self.stretch(config, dt_s);
        cut
    }

    /// Moves onto a reference that moves, which stays within the range of the bellows: at their border it moves along the border
    /// only. Where set-point and reference differ, their difference is brought to zero within the pace; so a reference that jumps
    /// moves the tip no faster than a target does.
    pub(super) fn follow(
        &mut self,
        config: &LoopConfig,
        reference: &Reference,
        pace: &Pace,
        dt_s: f64,
    ) -> Cut {
        let mut reference = *reference;
        let (shape, cut) = within_reach(config, &reference.shape);
        if cut != Cut::None {
            let outward = shape.bend.0.try_normalize(1e-9).unwrap_or_default();
            let along = |v: Vector2<f64>| v - outward * v.dot(&outward).max(0.0);
            (reference.shape, reference.rate) = (shape, along(reference.rate));
            reference.acceleration = along(reference.acceleration);
        }
        let (at, before) = (reference.shape.bend.0, self.bend.at);
        let mut difference = Follower {
            at: before - (at - reference.rate * dt_s),
            velocity: self.bend.velocity - reference.rate,
        };
        let acceleration = CATCH_UP * pace.acceleration.max(reference.acceleration.norm());
        let catch_up = Pace {
            acceleration,
            ..*pace
        };
        difference.step(&Vector2::zeros(), &catch_up, dt_s);
        // catching up takes no more than the pace either
        self.bend = Follower {
            at: before + (at + difference.at - before).cap_magnitude(pace.speed * dt_s),
            velocity: (reference.rate + difference.velocity).cap_magnitude(pace.speed),
        };
        (self.target, self.target_rests_s) = (reference.shape, 0.0);
        self.acceleration = Some(reference.acceleration);
        self.stretch(config, dt_s);
        cut
    }

    fn stretch(&mut self, config: &LoopConfig, dt_s: f64) {
        let target = Vector1::new(self.target.length.0);
        self.length.step(&target, &config.length_pace, dt_s);
    }

    /// `pace` with the acceleration of the present motion for as long as the bend is faster than `pace` permits or could not stop
    /// at the target with it: a target with a slower pace is not overshot.
    fn braking(&mut self, pace: &Pace) -> Pace {
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
        let departs = self.acceleration.is_some_and(|a| a != Vector2::zeros());
        let stands = self.bend.velocity == Vector2::zeros() && !departs;
        stands
            && self.bend.arrived(&self.target.bend.0)
            && self.length.arrived(&Vector1::new(self.target.length.0))
    }

    /// Velocity and acceleration of the bellow lengths, mm/s and mm/s², for a command that leads the set-point by `lead_s`;
    /// `None` without a reference that moves.
    pub(super) fn bellow_motion(
        &self,
        geometry: &Geometry,
        lead_s: f64,
    ) -> Option<[Vector3<f64>; 2]> {
        let acceleration = self.acceleration.filter(|_| !self.has_arrived())?;
        let velocity = self.bend.velocity + acceleration * lead_s;
        let lengths = |v| geometry.lengths(&Shape::new(v, geometry.rest_length_mm));
        Some([lengths(velocity), lengths(acceleration)])
    }
}

/// The shape within the range of the bellows.
fn within_reach(config: &LoopConfig, shape: &Shape) -> (Shape, Cut) {
    let (geometry, limits) = (&config.geometry, &config.limits);
    let (q_mm, cut) = limits.bellows(&geometry.lengths(shape), geometry.rest_length_mm);
    match cut {
        Cut::None => (*shape, cut),
        _ => (geometry.shape(&q_mm), cut),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Bend;

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
                let mut setpoint = SetPoint::resting(Shape::new(Vector2::zeros(), 10.0));
                setpoint.target.bend = Bend(Vector2::new(1.0, 0.0));
                let mut furthest: f64 = 0.0;
                for k in 0..1600 {
                    let changed = f64::from(k) * dt_s >= change_s;
                    let pace = setpoint.braking(if changed { &slow } else { &fast });
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
