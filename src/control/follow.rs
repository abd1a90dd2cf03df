//! Moves a point to a target under a speed and an acceleration limit.
//!
//! From distance `d` the point can stop if its speed is at most `√(2 a d)` (the braking parabola). The point aims for that
//! speed, and its velocity changes by at most `a dt` per tick. The target may change at any time. The bend set-point (a
//! point in the bend plane) and the centre length use this profile.

use nalgebra::SVector;

/// Speed and acceleration limits in the unit of the point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Largest speed, unit/s.
    pub speed: f64,
    /// Largest acceleration, unit/s².
    pub acceleration: f64,
}

/// A moving point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Follower<const D: usize> {
    /// Position.
    pub at: SVector<f64, D>,
    /// Velocity, unit/s.
    pub velocity: SVector<f64, D>,
}

impl<const D: usize> Follower<D> {
    /// At rest at `at`.
    pub fn resting(at: SVector<f64, D>) -> Self {
        Self {
            at,
            velocity: SVector::zeros(),
        }
    }

    /// One tick towards `target`.
    pub fn step(&mut self, target: &SVector<f64, D>, pace: &Pace, dt_s: f64) {
        let to_go = target - self.at;
        let distance = to_go.norm();
        let change_max = pace.acceleration * dt_s;
        if distance <= change_max * dt_s && self.velocity.norm() <= 2.0 * change_max {
            *self = Self::resting(*target);
            return;
        }
        // brake half a tick early, because the parabola is continuous and the ticks are not
        let braking = (2.0 * pace.acceleration * distance).sqrt() - 0.5 * change_max;
        let speed = braking.max(0.0).min(pace.speed).min(distance / dt_s);
        // exactly at the target with a velocity there is no direction to the target: brake
        let wanted = if distance > 0.0 {
            to_go * (speed / distance)
        } else {
            SVector::zeros()
        };
        self.velocity += (wanted - self.velocity).cap_magnitude(change_max);
        self.at += self.velocity * dt_s;
    }

    /// True once the point has reached `target`.
    pub fn arrived(&self, target: &SVector<f64, D>) -> bool {
        self.at == *target
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn keeps_limits_and_arrives(
            targets in prop::collection::vec((-2.0..2.0f64, -2.0..2.0f64), 1..8),
            dt_s in 0.0005..0.01f64,
        ) {
            let pace = Pace { speed: 1.5, acceleration: 10.0 };
            let mut f = Follower::<2>::resting(Vector2::zeros());
            let mut target = Vector2::zeros();
            for (x, y) in targets {
                target = Vector2::new(x, y);
                for _ in 0..40 {
                    let before = f;
                    f.step(&target, &pace, dt_s);
                    prop_assert!(f.velocity.norm() <= pace.speed + 1e-9);
                    prop_assert!((f.at - before.at).norm() <= pace.speed * dt_s + 1e-9);
                    prop_assert!((f.velocity - before.velocity).norm() <= 2.0 * pace.acceleration * dt_s + 1e-9);
                }
            }
            for _ in 0..(8.0 / dt_s) as usize {
                f.step(&target, &pace, dt_s);
            }
            prop_assert!(f.arrived(&target), "{f:?} {target:?}");
        }
    }

    #[test]
    fn passing_over_the_target_does_not_divide_by_zero() {
        let mut f = Follower::<1> {
            at: nalgebra::Vector1::new(1.0),
            velocity: nalgebra::Vector1::new(0.5),
        };
        f.step(
            &nalgebra::Vector1::new(1.0),
            &Pace {
                speed: 1.0,
                acceleration: 10.0,
            },
            0.001,
        );
        assert!(f.at.x.is_finite() && f.velocity.x < 0.5);
    }

    #[test]
    fn takes_the_time_of_a_trapezoidal_profile() {
        let pace = Pace {
            speed: 1.0,
            acceleration: 10.0,
        };
        let mut f = Follower::<1>::resting(nalgebra::Vector1::zeros());
        let target = nalgebra::Vector1::new(1.0);
        let ticks = (1..)
            .find(|_| {
                f.step(&target, &pace, 0.001);
                f.arrived(&target)
            })
            .unwrap_or(0);
        // 1 / 1 + 1 / 10 = 1.1 s
        assert!((1050..1200).contains(&ticks), "{ticks}");
    }
}
