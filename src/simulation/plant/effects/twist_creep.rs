//! Outside the catalogue: a held bend slowly twists the tip.
//!
//! The twist about the tip's axis creeps towards `T β / 60°` with one time constant and back.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.twist_creep]`
    TwistCreep at "effects.outside.twist_creep" sized by twist_deg; drawn by rng, severity {
        /// Twist T in the end at 60° of bend, degrees. Default 0 (none); plausible ±3 to 20. A larger value
        /// turns further.
        twist_deg: f64 = 0.0, -60.0..=60.0, "up to 20 is plausible", draw rng.sign() * rng.sized(5.0, 20.0, severity);
        /// Time constant, s. Default 8. A larger value is slower.
        over_s: f64 = 8.0, 0.01..=1e5, "some seconds are plausible", draw rng.between(3.0, 15.0);
    }
    /// A tip with the twist it has crept to.
    Twisting runs config {
        decay: Decay = Decay::new(config.over_s);
        twist: f64 = 0.0;
    }
}

impl Law for Twisting {
    fn twist(&mut self, bend: &Vector2<f64>, at: &Moment) -> f64 {
        let target = self.config.twist_deg.to_radians() * bend.norm() / std::f64::consts::FRAC_PI_3;
        self.twist += (target - self.twist) * self.decay.share(at.dt_s);
        self.twist
    }
}
