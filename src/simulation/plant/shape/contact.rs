//! A soft wall that stops the tip one way.
//!
//! Along the wall's normal `n`, bend beyond `x_w` by `d` is pressed back to `g ln(1 + d/g)` (tissue
//! that stiffens as it yields), of which `block` tells how much of it there is. While pressed, the
//! tip sticks sideways: it follows along the wall only once it is `μ` times the pressing behind.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// `[effects.contact]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Contact {
    /// How much of the wall there is, 0 to 1. Default 0 (none); 1 is tissue against the whole tip.
    /// Bigger holds back more.
    pub block: f64,
    /// Bend direction in which the wall lies, degrees. Default 0.
    pub direction_deg: f64,
    /// Bend at which the tip meets it, degrees. Default 30. Bigger is met later.
    pub at_deg: f64,
    /// Give g of the wall, degrees of bend. Default 6. Bigger is softer.
    pub give_deg: f64,
    /// Friction μ along the wall. Default 0.3. Bigger sticks more.
    pub friction: f64,
}

impl Default for Contact {
    fn default() -> Self {
        Self { block: 0.0, direction_deg: 0.0, at_deg: 30.0, give_deg: 6.0, friction: 0.3 }
    }
}

impl PlantEffect for Contact {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.contact.block", self.block, 0.0..=1.0, "1 is the whole wall")?;
        range("effects.contact.direction_deg", self.direction_deg, -360.0..=360.0, "one turn is enough")?;
        range("effects.contact.at_deg", self.at_deg, 1.0..=180.0, "the wall stands off the resting tip")?;
        range("effects.contact.give_deg", self.give_deg, 0.1..=90.0, "6 is soft tissue")?;
        range("effects.contact.friction", self.friction, 0.0..=2.0, "0.3 is wet tissue")
    }
    fn size(&self) -> f64 {
        self.block
    }
    fn scale(&mut self, factor: f64) {
        self.block = (self.block * factor).min(1.0);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            block: rng.sized(0.6, 1.0, severity).min(1.0),
            direction_deg: rng.angle_deg(),
            at_deg: rng.between(15.0, 40.0 - 15.0 * severity),
            give_deg: rng.between(3.0, 10.0),
            friction: rng.between(0.1, 0.5),
        }
    }
}

/// A wall with where the tip sticks to it.
#[derive(Debug, Clone)]
pub(crate) struct Touching {
    config: Contact,
    normal: Vector2<f64>,
    stuck: Option<f64>,
}

impl Touching {
    pub(crate) fn new(config: Contact) -> Self {
        let (sin, cos) = config.direction_deg.to_radians().sin_cos();
        Self { config, normal: Vector2::new(cos, sin), stuck: None }
    }

    /// The bend that the wall leaves of `free`, and whether it touches.
    pub(crate) fn step(&mut self, free: &Vector2<f64>) -> (Vector2<f64>, bool) {
        let along = Vector2::new(-self.normal.y, self.normal.x);
        let beyond = free.dot(&self.normal) - self.config.at_deg.to_radians();
        if beyond <= 0.0 {
            self.stuck = None;
            return (*free, false);
        }
        let give = self.config.give_deg.to_radians();
        let pressed = self.config.block * (beyond - give * (beyond / give).ln_1p());
        let (aside, hold) = (free.dot(&along), self.config.friction * pressed);
        let stuck = self.stuck.unwrap_or(aside).clamp(aside - hold, aside + hold);
        self.stuck = Some(stuck);
        (free - self.normal * pressed + along * (stuck - aside), true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_one_way_and_sticks() {
        let mut w = Touching::new(Contact { block: 1.0, friction: 0.5, ..Contact::default() });
        let rad = |x: f64, y: f64| Vector2::new(x.to_radians(), y.to_radians());
        assert_eq!(w.step(&rad(29.0, 50.0)), (rad(29.0, 50.0), false));
        assert_eq!(w.step(&rad(-60.0, 0.0)), (rad(-60.0, 0.0), false));
        let (b, touched) = w.step(&rad(60.0, 0.0));
        assert!(touched && (35.0..45.0).contains(&b.x.to_degrees()));
        let (dragged, _) = w.step(&rad(60.0, 20.0));
        assert!(dragged.y > 0.0 && dragged.y < rad(0.0, 20.0).y - 0.1);
        // meets it without a jump
        assert!((w.step(&rad(30.0, 0.0)).0 - rad(30.0, 0.0)).norm() < 1e-9);
    }
}
