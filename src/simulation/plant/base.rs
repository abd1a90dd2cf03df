//! How the base stands in the world, and how it turns while nobody asked it to.
//!
//! One slow move: an angle about a world axis that rises as the smoothest step there is,
//! `½ (1 + tanh(5 (t − t_m)/T))` about the middle of its duration `T`; and a sway beside it, the sum of
//! two sines whose periods stand in the golden ratio and so never repeat.

use crate::primitives::frames::{Rotation, World};
use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use crate::simulation::plant::shape::arc::Plate;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// `[effects.base_motion]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaseMotion {
    /// Angle that the base turns by, degrees. Default 0 (none); typical 1 to 10. Bigger turns
    /// further.
    pub angle_deg: f64,
    /// Axis of the turn in the world, any length. Default [0, 1, 0].
    pub axis: [f64; 3],
    /// When the turn begins, s. Default 15.
    pub at_s: f64,
    /// How long it takes, s. Default 6. Bigger is slower.
    pub over_s: f64,
    /// Sway beside it about the same axis, degrees. Default 0; typical 0 to 2. Bigger never holds
    /// still.
    pub sway_deg: f64,
    /// Period of the sway, s. Default 7. Nothing sways during the first 3 s, which are rest.
    pub sway_period_s: f64,
}

impl Default for BaseMotion {
    fn default() -> Self {
        Self { angle_deg: 0.0, axis: [0.0, 1.0, 0.0], at_s: 15.0, over_s: 6.0, sway_deg: 0.0, sway_period_s: 7.0 }
    }
}

impl PlantEffect for BaseMotion {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.base_motion.angle_deg", self.angle_deg, -180.0..=180.0, "1 to 10 is typical")?;
        ranges("effects.base_motion.axis", &self.axis, -1e3..=1e3, "a direction")?;
        range("effects.base_motion.axis length", Vector3::from(self.axis).norm(), 1e-3..=1e4, "a direction has a length")?;
        range("effects.base_motion.at_s", self.at_s, 0.0..=1e9, "seconds since the start")?;
        range("effects.base_motion.over_s", self.over_s, 0.05..=1e6, "some seconds are typical")?;
        range("effects.base_motion.sway_deg", self.sway_deg, -30.0..=30.0, "a degree or two is typical")?;
        range("effects.base_motion.sway_period_s", self.sway_period_s, 0.2..=1e6, "some seconds are typical")
    }
    fn size(&self) -> f64 {
        self.angle_deg.abs().max(self.sway_deg.abs())
    }
    fn scale(&mut self, factor: f64) {
        self.angle_deg = (self.angle_deg * factor).clamp(-180.0, 180.0);
        self.sway_deg *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let angle_deg = rng.sized(3.0, 12.0, severity);
        Self {
            angle_deg,
            axis: rng.direction().into(),
            at_s: rng.between(8.0, 35.0),
            over_s: rng.between(2.0, 15.0),
            sway_deg: if rng.chance(0.5) { angle_deg * rng.between(0.05, 0.2) } else { 0.0 },
            sway_period_s: rng.between(5.0, 20.0),
        }
    }
}

/// Seconds of rest before a sway, and over which it grows.
const STILL_S: f64 = 3.0;
const GOLDEN: f64 = 1.618_033_988_749_895;

impl BaseMotion {
    /// Angle about the axis at time `t`, rad.
    fn angle(&self, t: f64) -> f64 {
        let step = if t < self.at_s { 0.0 } else { smooth_step((t - self.at_s) / self.over_s) };
        let since = (t - STILL_S).max(0.0);
        let grown = 1.0 - (-since / STILL_S).exp();
        let phase = TAU * since / self.sway_period_s;
        let sway = grown * (0.6 * phase.sin() + 0.4 * (GOLDEN * phase).sin());
        (self.angle_deg * step + self.sway_deg * sway).to_radians()
    }
    fn turn(&self, t: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::from(self.axis).normalize() * self.angle(t))
    }
}

/// From 0 at 0 to 1 at 1 along a tanh, cut so that both ends are exact.
fn smooth_step(x: f64) -> f64 {
    let s = |x: f64| (5.0 * (x - 0.5)).tanh();
    ((s(x.clamp(0.0, 1.0)) / s(1.0)) + 1.0) * 0.5
}

/// A turn that is under way.
#[derive(Debug, Clone, Copy)]
struct Turn {
    axis: Vector3<f64>,
    from_s: f64,
    over_s: f64,
}

/// The base with how it was turned so far.
#[derive(Debug, Clone)]
pub(crate) struct Stand {
    rest: Rotation<World, Plate>,
    motion: Option<BaseMotion>,
    turned: UnitQuaternion<f64>,
    turn: Option<Turn>,
}

impl Stand {
    pub(crate) fn new(rest: Rotation<World, Plate>, motion: Option<BaseMotion>) -> Self {
        Self { rest, motion, turned: UnitQuaternion::identity(), turn: None }
    }
    /// Begins to turn by `rotation` (a rotation vector in the world, rad) over some seconds.
    pub(crate) fn begin_turn(&mut self, rotation: Vector3<f64>, t: f64, over_s: f64) {
        self.settle(t);
        self.turn = Some(Turn { axis: rotation, from_s: t, over_s });
    }
    /// Stops a turn where it is.
    pub(crate) fn settle(&mut self, t: f64) {
        self.turned = self.turned_at(t);
        self.turn = None;
    }
    fn turned_at(&self, t: f64) -> UnitQuaternion<f64> {
        let Some(turn) = &self.turn else { return self.turned };
        let share = if turn.over_s > 0.0 { smooth_step((t - turn.from_s) / turn.over_s) } else { 1.0 };
        UnitQuaternion::from_scaled_axis(turn.axis * share) * self.turned
    }
    /// Attitude at time `t`.
    pub(crate) fn attitude(&self, t: f64) -> Rotation<World, Plate> {
        if self.motion.is_none() && self.turn.is_none() && self.turned == UnitQuaternion::identity() {
            return self.rest;
        }
        let slow = self.motion.as_ref().map_or_else(UnitQuaternion::identity, |m| m.turn(t));
        Rotation::assert_frames(self.turned_at(t) * slow * self.rest.quat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_once_by_its_angle_and_rests_before() {
        let m = BaseMotion { angle_deg: 5.0, sway_deg: 0.0, ..BaseMotion::default() };
        assert_eq!(m.angle(14.9), 0.0);
        assert!((m.angle(18.0).to_degrees() - 2.5).abs() < 1e-9 && (m.angle(30.0).to_degrees() - 5.0).abs() < 1e-9);
        let sway = BaseMotion { sway_deg: 1.0, ..BaseMotion::default() };
        assert_eq!(sway.angle(2.9), 0.0);
        assert!((30..300).any(|k| sway.angle(f64::from(k) * 0.1).to_degrees().abs() > 0.4));
    }

    #[test]
    fn faults_add_up() {
        let mut s = Stand::new(Rotation::identity(), None);
        s.begin_turn(Vector3::x() * 0.1, 1.0, 2.0);
        assert!((s.attitude(2.0).quat().angle() - 0.05).abs() < 1e-9);
        s.begin_turn(Vector3::x() * 0.2, 5.0, 0.0);
        assert!((s.attitude(6.0).quat().angle() - 0.3).abs() < 1e-9);
    }
}
