//! A restart with a bent tip: is it where it was remembered?
//!
//! From before the restart the rest is known (gravity and field in the base frame) and the bend b. If
//! the tip still is at b and the base where it was, the still tip must now read `R(b)⁻¹ g` and `R(b)⁻¹ m`.
//! Agreement proves it as far as two directions can; a contradiction, or nothing to compare with, does
//! not, and then nothing moves.

use crate::control::tick::{LoopConfig, LoopState, RestartState};
use crate::model::bend::Bend;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// When a restart counts as proved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RestartCheckConfig {
    /// Largest angle between gravity as felt and as remembered, degrees. Default 4. Larger continues
    /// after a larger change, and with a larger error.
    pub gravity_deg: f64,
    /// Largest angle between the field as felt and as remembered, degrees. Default 10. Larger
    /// tolerates iron that was moved meanwhile.
    pub field_deg: f64,
}

impl Default for RestartCheckConfig {
    fn default() -> Self {
        Self { gravity_deg: 4.0, field_deg: 10.0 }
    }
}

/// Whether the still stretch just found agrees with what was kept.
#[must_use]
pub fn holds(config: &RestartCheckConfig, kept: &RestartState, state: &LoopState) -> bool {
    let (Some(now), Some(then)) = (state.fusion.rest(), &kept.rest) else { return false };
    let bent = Bend(kept.bend_rad.into()).rotation().inverse();
    let apart = |estimate: &Vector3<f64>, rest: [f64; 3]| estimate.angle(&bent.apply(&Vector3::from(rest))).to_degrees();
    let gravity = apart(&now.acc_rest_m_s2, then.acc_m_s2) <= config.gravity_deg;
    let field = match (now.mag_rest_ut, then.mag_ut) {
        (Some(estimate), Some(rest)) => apart(&estimate, rest) <= config.field_deg,
        (None, Some(_)) => false,
        (_, None) => true,
    };
    gravity && field
}

/// Takes the remembered rest and bend for the truth, and the pistons for where they were.
pub fn believe(config: &LoopConfig, state: &mut LoopState, kept: &RestartState) {
    let Some(rest) = &kept.rest else { return };
    let bend = Bend(kept.bend_rad.into());
    state.fusion.assume(&config.fuse, bend, &Vector3::from(rest.acc_m_s2), rest.mag_ut.map(Vector3::from));
    state.take_up(config, kept);
}
