//! A soft wall that stops the tip one way.
//!
//! Along the wall's normal `n`, bend beyond `x_w` by `d` is pressed back to `g ln(1 + d/g)` (tissue
//! that stiffens as it yields), scaled by `block`. While pressed, the tip sticks sideways: it follows along the
//! wall only once it lags by `μ` times the pressing.

use crate::simulation::plant::prelude::*;

parameters! {
    /// `[effects.contact]`
    Contact at "effects.contact" sized by block {
        /// How much of the wall there is, 0 to 1. Default 0 (none); 1 is tissue against the whole tip.
        /// A larger value holds back more.
        block: f64 = 0.0, "", 0.0..=1.0, "1 is the whole wall";
        /// Bend direction in which the wall lies, degrees. Default 0.
        direction_deg: f64 = 0.0, "", -360.0..=360.0, "one turn is enough";
        /// Bend at which the tip meets it, degrees. Default 30. A larger value is met later.
        at_deg: f64 = 30.0, "", 1.0..=180.0, "the wall stands off the resting tip";
        /// Give g of the wall, degrees of bend. Default 6. A larger value is softer.
        give_deg: f64 = 6.0, "", 0.1..=90.0, "6 is soft tissue";
        /// Friction μ along the wall. Default 0.3. A larger value sticks more.
        friction: f64 = 0.3, "", 0.0..=2.0, "0.3 is wet tissue";
        /// When the wall goes away, s. Default never. A larger value leaves it for longer.
        until_s: f64 = 1e9, "", 0.0..=1e9, "seconds since the start";
    }
}

impl PlantEffect for Contact {
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self {
            block: rng.sized(0.6, 1.0, severity).min(1.0),
            direction_deg: rng.angle_deg(),
            at_deg: rng.between(15.0, 40.0 - 15.0 * severity),
            give_deg: rng.between(3.0, 10.0),
            friction: rng.between(0.1, 0.5),
            ..Self::default()
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
        Self {
            config,
            normal: Vector2::new(cos, sin),
            stuck: None,
        }
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
        let stuck = self
            .stuck
            .unwrap_or(aside)
            .clamp(aside - hold, aside + hold);
        self.stuck = Some(stuck);
        (free - self.normal * pressed + along * (stuck - aside), true)
    }
}

impl Law for Touching {
    fn contact(&mut self, bend: &mut Vector2<f64>, at: &Moment) -> bool {
        if at.t > self.config.until_s {
            self.stuck = None;
            return false;
        }
        let (left, touched) = self.step(bend);
        *bend = left;
        touched
    }
    fn release(&mut self) {
        self.stuck = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wall_stops_the_tip_one_way_and_holds_it_sideways() {
        let mut w = Touching::new(Contact {
            block: 1.0,
            friction: 0.5,
            until_s: 5.0,
            ..Contact::default()
        });
        let rad = |x: f64, y: f64| Vector2::new(x.to_radians(), y.to_radians());
        assert_eq!(w.step(&rad(29.0, 50.0)), (rad(29.0, 50.0), false));
        assert_eq!(w.step(&rad(-60.0, 0.0)), (rad(-60.0, 0.0), false));
        let (b, touched) = w.step(&rad(60.0, 0.0));
        assert!(touched && (35.0..45.0).contains(&b.x.to_degrees()));
        let (dragged, _) = w.step(&rad(60.0, 20.0));
        assert!(dragged.y > 0.0 && dragged.y < rad(0.0, 20.0).y - 0.1);
        let mut there = |t: f64| w.contact(&mut rad(60.0, 0.0), &Moment { t, dt_s: 0.001 });
        assert!(there(5.0) && !there(5.1), "the wall goes away");
        // meets it without a jump
        assert!((w.step(&rad(30.0, 0.0)).0 - rad(30.0, 0.0)).norm() < 1e-9);
    }
}
