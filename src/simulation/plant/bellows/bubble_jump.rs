//! Outside the catalogue: a bubble moves and a line's compliance is another, at once.
//!
//! From `at_s` on (until `until_s`) the air of one line gives way `factor` times as much.

use crate::simulation::plant::check::{PlantError, channel, range};
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use serde::{Deserialize, Serialize};

/// `[effects.outside.bubble_jump]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BubbleJump {
    /// Change of the line's compliance, as a share of it. Default 0 (none); plausible ±0.2 to 0.6.
    /// Bigger jumps further.
    pub change: f64,
    /// Channel of the line, 1 to 3. Default 1.
    pub channel: usize,
    /// When it happens, s. Default 20.
    pub at_s: f64,
    /// When it goes back, s. Default 1e9 (never).
    pub until_s: f64,
}

impl Default for BubbleJump {
    fn default() -> Self {
        Self { change: 0.0, channel: 1, at_s: 20.0, until_s: 1e9 }
    }
}

impl PlantEffect for BubbleJump {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.bubble_jump.change", self.change, -0.95..=5.0, "a share of k_ε")?;
        channel("effects.outside.bubble_jump.channel", self.channel)?;
        range("effects.outside.bubble_jump.at_s", self.at_s, 0.0..=1e9, "seconds since the start")?;
        range("effects.outside.bubble_jump.until_s", self.until_s, 0.0..=1e12, "seconds since the start")
    }
    fn size(&self) -> f64 {
        self.change
    }
    fn scale(&mut self, factor: f64) {
        self.change = (self.change * factor).max(-0.95);
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        let at_s = rng.between(15.0, 50.0);
        let until_s = if rng.chance(0.5) { 1e9 } else { at_s + rng.between(10.0, 40.0) };
        let change = rng.sized(0.25, 0.8, severity);
        Self { change: if rng.chance(0.3) { -0.7 * change } else { change }, channel: rng.channel(), at_s, until_s }
    }
}

impl BubbleJump {
    /// Factor on the compliance of the channel at time `t`.
    pub(crate) fn factor(&self, t: f64) -> f64 {
        if t >= self.at_s && t < self.until_s { 1.0 + self.change } else { 1.0 }
    }
}
