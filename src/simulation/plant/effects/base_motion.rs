//! The base turns during the log: one slow turn, and a sway.
//!
//! The turn is an angle about a world axis that rises along the smooth step `½ (1 + tanh(5 (t − t_m)/T))` about
//! the middle of its duration `T`. The sway is the sum of two sines whose periods are in the golden ratio, so
//! that the sum never repeats.

use crate::simulation::plant::prelude::*;
use crate::simulation::plant::stand::smooth_step;
use std::f64::consts::TAU;

effect! {
    /// `[effects.base_motion]`
    BaseMotion at "effects.base_motion" sized by angle_deg, sway_deg; directed by axis; drawn by rng, severity {
        let angle_deg = rng.sized(3.0, 12.0, severity);
        /// Angle that the base turns by, degrees. Default 0 (none); typical 1 to 10. A larger value turns
        /// further.
        angle_deg: f64 = 0.0, -180.0..=180.0, "1 to 10 is typical", draw angle_deg;
        /// Axis of the turn in the world, any length. Default [0, 1, 0].
        axis: [f64; 3] = [0.0, 1.0, 0.0], -1e3..=1e3, "a direction", draw rng.direction().into();
        /// When the turn begins, s. Default 15.
        at_s: f64 = 15.0, 0.0..=1e9, "seconds since the start", draw rng.between(8.0, 35.0);
        /// How long it takes, s. Default 6. A larger value is slower.
        over_s: f64 = 6.0, 0.05..=1e6, "some seconds are typical", draw rng.between(2.0, 15.0);
        /// Sway about the same axis, degrees. Default 0; typical 0 to 2. A larger value moves more.
        sway_deg: f64 = 0.0, -30.0..=30.0, "a degree or two is typical",
            draw if rng.chance(0.5) { angle_deg * rng.between(0.05, 0.2) } else { 0.0 };
        /// Period of the sway, s. Default 7. There is no sway during the first 3 s.
        sway_period_s: f64 = 7.0, 0.2..=1e6, "some seconds are typical", draw rng.between(5.0, 20.0);
    }
}

/// Time before a sway begins, and over which it grows, s.
const STILL_S: f64 = 3.0;
/// Golden ratio.
const GOLDEN: f64 = 1.618_033_988_749_895;

impl BaseMotion {
    /// Angle about the axis at time `t`, rad.
    fn angle(&self, t: f64) -> f64 {
        let step = smooth_step((t - self.at_s) / self.over_s);
        let since = (t - STILL_S).max(0.0);
        let grown = 1.0 - (-since / STILL_S).exp();
        let phase = TAU * since / self.sway_period_s;
        let sway = grown * (0.6 * phase.sin() + 0.4 * (GOLDEN * phase).sin());
        (self.angle_deg * step + self.sway_deg * sway).to_radians()
    }
}

impl Law for BaseMotion {
    fn base(&self, t: f64) -> Option<UnitQuaternion<f64>> {
        Some(UnitQuaternion::from_scaled_axis(
            Vector3::from(self.axis).normalize() * self.angle(t),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_base_turns_once_by_the_angle_and_stands_before() {
        let m = BaseMotion {
            angle_deg: 5.0,
            sway_deg: 0.0,
            ..BaseMotion::default()
        };
        assert_eq!(m.angle(14.9), 0.0);
        assert!(
            (m.angle(18.0).to_degrees() - 2.5).abs() < 1e-9
                && (m.angle(30.0).to_degrees() - 5.0).abs() < 1e-9
        );
        let sway = BaseMotion {
            sway_deg: 1.0,
            ..BaseMotion::default()
        };
        assert_eq!(sway.angle(2.9), 0.0);
        assert!((30..300).any(|k| sway.angle(f64::from(k) * 0.1).to_degrees().abs() > 0.4));
    }
}
