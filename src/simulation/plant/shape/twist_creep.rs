//! Outside the catalogue: a held bend slowly unscrews the tip.
//!
//! The twist about the tip's axis creeps towards `T β / 60°` with one time constant and back.

use crate::simulation::plant::check::{PlantError, range};
use crate::simulation::plant::memory::Decay;
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// `[effects.outside.twist_creep]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwistCreep {
    /// Twist T in the end at 60° of bend, degrees. Default 0 (none); plausible ±3 to 20. Bigger
    /// turns further.
    pub twist_deg: f64,
    /// Time constant, s. Default 8. Bigger is slower.
    pub over_s: f64,
}

impl Default for TwistCreep {
    fn default() -> Self {
        Self { twist_deg: 0.0, over_s: 8.0 }
    }
}

impl PlantEffect for TwistCreep {
    fn check(&self) -> Result<(), PlantError> {
        range("effects.outside.twist_creep.twist_deg", self.twist_deg, -60.0..=60.0, "up to 20 is plausible")?;
        range("effects.outside.twist_creep.over_s", self.over_s, 0.01..=1e5, "some seconds are plausible")
    }
    fn size(&self) -> f64 {
        self.twist_deg
    }
    fn scale(&mut self, factor: f64) {
        self.twist_deg *= factor;
    }
    fn draw(severity: f64, rng: &mut PlantRng) -> Self {
        Self { twist_deg: rng.sign() * rng.sized(5.0, 20.0, severity), over_s: rng.between(3.0, 15.0) }
    }
}

/// A tip with the twist it has crept to.
#[derive(Debug, Clone)]
pub(crate) struct Twisting {
    config: TwistCreep,
    decay: Decay,
    twist: f64,
}

impl Twisting {
    pub(crate) fn new(config: TwistCreep) -> Self {
        let decay = Decay::new(config.over_s);
        Self { config, decay, twist: 0.0 }
    }
    /// Twist, rad, after `dt_s` at a bend.
    pub(crate) fn step(&mut self, bend: &Vector2<f64>, dt_s: f64) -> f64 {
        let target = self.config.twist_deg.to_radians() * bend.norm() / std::f64::consts::FRAC_PI_3;
        self.twist += (target - self.twist) * self.decay.share(dt_s);
        self.twist
    }
}
