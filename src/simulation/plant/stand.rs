//! The attitude of the base in the world, and the turns that faults give it.

use crate::primitives::{Rotation, World};
use crate::simulation::plant::law::Laws;
use crate::simulation::plant::shape::arc::Plate;
use nalgebra::{UnitQuaternion, Vector3};

/// From 0 at 0 to 1 at 1 along a tanh, scaled so that both ends are exact.
pub(crate) fn smooth_step(x: f64) -> f64 {
    let s = |x: f64| (5.0 * (x - 0.5)).tanh();
    ((s(x.clamp(0.0, 1.0)) / s(1.0)) + 1.0) * 0.5
}

/// A turn in progress.
#[derive(Debug, Clone, Copy)]
struct Turn {
    rotation: Vector3<f64>,
    from_s: f64,
    over_s: f64,
}

/// The base with the turns that faults gave it.
#[derive(Debug, Clone)]
pub(crate) struct Stand {
    rest: Rotation<World, Plate>,
    turned: UnitQuaternion<f64>,
    turn: Option<Turn>,
}

impl Stand {
    pub(crate) fn new(rest: Rotation<World, Plate>) -> Self {
        Self {
            rest,
            turned: UnitQuaternion::identity(),
            turn: None,
        }
    }
    /// Begins to turn by `rotation` (a rotation vector in the world, rad) over `over_s` seconds.
    pub(crate) fn begin_turn(&mut self, rotation: Vector3<f64>, t: f64, over_s: f64) {
        self.settle(t);
        self.turn = Some(Turn {
            rotation,
            from_s: t,
            over_s,
        });
    }
    /// Stops a turn where it is.
    pub(crate) fn settle(&mut self, t: f64) {
        self.turned = self.turned_at(t);
        self.turn = None;
    }
    fn turned_at(&self, t: f64) -> UnitQuaternion<f64> {
        let Some(turn) = &self.turn else {
            return self.turned;
        };
        let share = if turn.over_s > 0.0 {
            smooth_step((t - turn.from_s) / turn.over_s)
        } else {
            1.0
        };
        UnitQuaternion::from_scaled_axis(turn.rotation * share) * self.turned
    }
    /// Attitude at time `t`.
    pub(crate) fn attitude(&self, t: f64, laws: &Laws) -> Rotation<World, Plate> {
        let moved = laws.iter().find_map(|law| law.base(t));
        if moved.is_none() && self.turn.is_none() && self.turned == UnitQuaternion::identity() {
            return self.rest;
        }
        Rotation::assert_frames(self.turned_at(t) * moved.unwrap_or_default() * self.rest.quat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_add_up() {
        let mut s = Stand::new(Rotation::identity());
        let angle = |s: &Stand, t: f64| s.attitude(t, &Vec::new()).quat().angle();
        s.begin_turn(Vector3::x() * 0.1, 1.0, 2.0);
        assert!((angle(&s, 2.0) - 0.05).abs() < 1e-9);
        s.begin_turn(Vector3::x() * 0.2, 5.0, 0.0);
        assert!((angle(&s, 6.0) - 0.3).abs() < 1e-9);
    }
}
