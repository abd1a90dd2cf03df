//! A soft wall that stops the tip one way.
//!
//! Along the wall's normal `n`, bend beyond `x_w` by `d` is pressed back to `g ln(1 + d/g)` (tissue
//! that stiffens as it yields), scaled by `block`. While pressed, the tip sticks sideways: it follows along the
//! wall only once it lags by `μ` times the pressing.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.contact]`
    Contact at "effects.contact" sized by block; drawn by rng, severity {
        /// How much of the wall there is, 0 to 1. Default 0 (none); 1 is tissue against the whole tip.
        /// A larger value holds back more.
        block: f64 = 0.0, 0.0..=1.0, "1 is the whole wall", draw rng.sized(0.6, 1.0, severity).min(1.0);
        /// Bend direction in which the wall lies, degrees. Default 0.
        direction_deg: f64 = 0.0, -360.0..=360.0, "one turn is enough", draw rng.angle_deg();
        /// Bend at which the tip meets it, degrees. Default 30. A larger value is met later.
        at_deg: f64 = 30.0, 1.0..=180.0, "the wall stands off the resting tip",
            draw rng.between(15.0, 40.0 - 15.0 * severity);
        /// Give g of the wall, degrees of bend. Default 6. A larger value is softer.
        give_deg: f64 = 6.0, 0.1..=90.0, "6 is soft tissue", draw rng.between(3.0, 10.0);
        /// Friction μ along the wall. Default 0.3. A larger value sticks more.
        friction: f64 = 0.3, 0.0..=2.0, "0.3 is wet tissue", draw rng.between(0.1, 0.5);
        /// When the wall goes away, s. Default never. A larger value leaves it for longer.
        until_s: f64 = 1e9, 0.0..=1e9, "seconds since the start";
    }
    /// A wall with where the tip sticks to it.
    Touching runs config {
        normal: Vector2<f64> = toward(config.direction_deg);
        stuck: Option<f64> = None;
    }
}

impl Law for Touching {
    fn contact(&mut self, bend: &mut Vector2<f64>, at: &Moment) -> bool {
        let along = Vector2::new(-self.normal.y, self.normal.x);
        let beyond = bend.dot(&self.normal) - self.config.at_deg.to_radians();
        if at.t > self.config.until_s || beyond <= 0.0 {
            self.stuck = None;
            return false;
        }
        let give = self.config.give_deg.to_radians();
        let pressed = self.config.block * (beyond - give * (beyond / give).ln_1p());
        let (aside, hold) = (bend.dot(&along), self.config.friction * pressed);
        let stuck = self
            .stuck
            .unwrap_or(aside)
            .clamp(aside - hold, aside + hold);
        self.stuck = Some(stuck);
        *bend = *bend - self.normal * pressed + along * (stuck - aside);
        true
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
        let step = |w: &mut Touching, free: &Vector2<f64>| {
            let mut bend = *free;
            let touched = w.contact(
                &mut bend,
                &Moment {
                    t: 0.0,
                    dt_s: 0.001,
                },
            );
            (bend, touched)
        };
        assert_eq!(step(&mut w, &rad(29.0, 50.0)), (rad(29.0, 50.0), false));
        assert_eq!(step(&mut w, &rad(-60.0, 0.0)), (rad(-60.0, 0.0), false));
        let (b, touched) = step(&mut w, &rad(60.0, 0.0));
        assert!(touched && (35.0..45.0).contains(&b.x.to_degrees()));
        let (dragged, _) = step(&mut w, &rad(60.0, 20.0));
        assert!(dragged.y > 0.0 && dragged.y < rad(0.0, 20.0).y - 0.1);
        let mut there = |t: f64| w.contact(&mut rad(60.0, 0.0), &Moment { t, dt_s: 0.001 });
        assert!(there(5.0) && !there(5.1), "the wall goes away");
        // meets it without a jump
        assert!((step(&mut w, &rad(30.0, 0.0)).0 - rad(30.0, 0.0)).norm() < 1e-9);
    }
}
