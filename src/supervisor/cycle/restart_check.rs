//! Check of the remembered pose after a restart with a bent tip.
//!
//! The rest pose (gravity and field in the base frame) and the bend b are remembered. If neither tip nor base has moved,
//! the still tip measures `R(b)⁻¹ g` and `R(b)⁻¹ m`. If it measures anything else, or if there is nothing to compare
//! with, the position of the pistons counts as unknown.

use crate::control::{LoopConfig, LoopState, RestartState};
use crate::model::Bend;
use crate::parameters;
use nalgebra::Vector3;

parameters! {
    /// Restart with a bent tip: when the tip counts as being where it was.
    pub struct RestartCheckConfig: Copy {
        /// Largest angle between measured and remembered gravity. A larger value continues after a larger change, and with a
        /// larger error.
        gravity_deg: f64 = 4.0, "deg", 0.1..=45.0, "a few degrees";
        /// Largest angle between measured and remembered field. A larger value tolerates iron that was moved meanwhile.
        field_deg: f64 = 10.0, "deg", 0.1..=90.0, "some degrees more than gravity";
        /// Largest angle from the remembered straight attitude at which `zero` is accepted. A larger value accepts a tip that
        /// hangs further away, and every bend is then off by as much.
        straight_deg: f64 = 2.0, "deg", 0.1..=45.0, "2 is a little more than the noise of an alignment";
    }
}

/// True if the alignment that has just ended agrees with the remembered state.
pub fn agrees(config: &RestartCheckConfig, remembered: &RestartState, state: &LoopState) -> bool {
    let (Some(now), Some(then)) = (state.fusion.alignment(), &remembered.rest) else {
        return false;
    };
    let tip_from_base = Bend(remembered.bend_rad.into()).rotation().inverse();
    let angle_deg = |measured: &Vector3<f64>, rest: [f64; 3]| {
        let remembered = tip_from_base.apply(&Vector3::from(rest));
        measured.angle(&remembered).to_degrees()
    };
    let gravity = angle_deg(&now.acc_rest_m_s2, then.acc_m_s2) <= config.gravity_deg;
    let field = match (now.mag_rest_ut, then.mag_ut) {
        (Some(measured), Some(rest)) => angle_deg(&measured, rest) <= config.field_deg,
        (None, Some(_)) => false,
        (_, None) => true,
    };
    gravity && field
}

/// Continues with the remembered rest pose, bend and pistons.
pub fn resume(config: &LoopConfig, state: &mut LoopState, remembered: &RestartState) {
    let Some(rest) = &remembered.rest else { return };
    let bend = Bend(remembered.bend_rad.into());
    let (gravity, field) = (rest.acc_m_s2.into(), rest.mag_ut.map(Vector3::from));
    state.fusion.assume(bend, &gravity, field);
    state.take_up(config, remembered);
}
