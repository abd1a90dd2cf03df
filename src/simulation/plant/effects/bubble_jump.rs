//! Outside the catalogue: a bubble moves and the compliance of a line changes at once.
//!
//! From `at_s` until `until_s` the air of one line is compliant by the factor `1 + change`.

use crate::simulation::plant::prelude::*;

effect! {
    /// `[effects.outside.bubble_jump]`
    BubbleJump at "effects.outside.bubble_jump" sized by change; drawn by rng, severity {
        let at_s = rng.between(15.0, 50.0);
        let until_s = if rng.chance(0.5) { 1e9 } else { at_s + rng.between(10.0, 40.0) };
        let change = rng.sized(0.25, 0.8, severity);
        /// Change of the line's compliance, as a share of it. Default 0 (none); plausible ±0.2 to 0.6.
        /// A larger value jumps further.
        change: f64 = 0.0, -0.95..=5.0, "a share of k_ε", draw if rng.chance(0.3) { -0.7 * change } else { change };
        /// Channel of the line, 1 to 3. Default 1.
        channel: usize = 1, 1..=3, "channels are counted from 1 to 3", draw rng.channel();
        /// When it happens, s. Default 20.
        at_s: f64 = 20.0, 0.0..=1e9, "seconds since the start", draw at_s;
        /// When it goes back, s. Default 1e9 (never).
        until_s: f64 = 1e9, 0.0..=1e12, "seconds since the start", draw until_s;
    }
}

impl Law for BubbleJump {
    fn compliance(&self, compliance: &mut Vector3<f64>, t: f64) {
        if (self.at_s..self.until_s).contains(&t) {
            compliance[self.channel - 1] *= 1.0 + self.change;
        }
    }
}
