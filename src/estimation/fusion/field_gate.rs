//! Rejects a disturbed magnetic field.
//!
//! The gate compares strength and dip of the field with a slowly adapting reference and rejects a field that
//! differs, for a limited time. A different field that stays constant while the sensor turns becomes the new
//! reference (after Laidig & Seel 2023, section 3.6). Strength and dip do not depend on the heading, which is the
//! quantity to protect.

use super::health::FieldShape;
use super::intake::share;
use crate::primitives::lasting;
use nalgebra::Vector3;

crate::constants! {
    /// When a field is rejected and accepted again: the settings that Laidig & Seel publish for VQF.
    const GATE: GateConstants;
    /// Largest relative difference of the strength from the reference.
    strength_share = 0.1;
    /// Largest difference of the dip from the reference, degrees.
    dip_deg = 10.0;
    /// Time constant with which the reference follows an accepted field, s.
    reference_tau_s = 20.0;
    /// Time for which the field must agree before it is accepted again, s.
    regain_s = 0.5;
    /// Longest full rejection, s: after a minute the gyroscope may have drifted further than a disturbed field deviates.
    reject_max_s = 60.0;
    /// Weight of a field that is still disturbed after the longest rejection.
    weight_after = 0.5;
    /// Time of turning over which a different field must stay constant to become the reference, s.
    accept_s = 20.0;
    /// Angular rate above which a constant field is significant, °/s: a still sensor sees any field as constant.
    turning_deg_s = 20.0;
}

impl FieldShape {
    /// Shape of a field given in the world frame, µT.
    fn of(field_world: &Vector3<f64>) -> Self {
        Self {
            norm_ut: field_world.norm(),
            dip_rad: (-field_world.z).atan2(field_world.xy().norm()),
        }
    }
    fn near(&self, other: &Self) -> bool {
        (self.norm_ut - other.norm_ut).abs() < GATE.strength_share * other.norm_ut
            && (self.dip_rad - other.dip_rad).abs() < GATE.dip_deg.to_radians()
    }
    fn follow(&mut self, target: &Self, share: f64) {
        self.norm_ut += share * (target.norm_ut - self.norm_ut);
        self.dip_rad += share * (target.dip_rad - self.dip_rad);
    }
}

/// Accepts or rejects the magnetic field.
#[derive(Debug, Clone, Copy, Default)]
pub struct FieldGate {
    reference: Option<FieldShape>,
    /// A field that may replace the reference, and the time of turning for which it has stayed constant, s.
    candidate: Option<FieldShape>,
    candidate_s: f64,
    agreed_s: f64,
    rejected_s: f64,
    /// True while the field differs from the reference.
    pub disturbed: bool,
}

impl FieldGate {
    /// Takes the field in the world frame (µT), the angular rate (rad/s) and the time since the previous field.
    /// Returns the weight of its heading, 0 to 1. The first field becomes the reference.
    pub fn update(&mut self, field_world: &Vector3<f64>, turning_rad_s: f64, dt_s: f64) -> f64 {
        let now = FieldShape::of(field_world);
        let reference = self.reference.get_or_insert(now);
        let candidate = self.candidate.get_or_insert(now);
        let agrees = now.near(reference);
        self.agreed_s = lasting(agrees, self.agreed_s, dt_s);
        if !agrees {
            self.disturbed = true;
        } else if self.agreed_s >= GATE.regain_s {
            self.disturbed = false;
            reference.follow(&now, share(dt_s, GATE.reference_tau_s));
        }
        if now.near(candidate) {
            candidate.follow(&now, share(dt_s, GATE.reference_tau_s));
            let turns = turning_rad_s >= GATE.turning_deg_s.to_radians();
            self.candidate_s += if turns { dt_s } else { 0.0 };
            if self.disturbed && self.candidate_s >= GATE.accept_s {
                *reference = *candidate;
                (self.agreed_s, self.disturbed) = (GATE.regain_s, false);
            }
        } else {
            (*candidate, self.candidate_s) = (now, 0.0);
        }
        self.weight(dt_s)
    }

    fn weight(&mut self, dt_s: f64) -> f64 {
        if !self.disturbed {
            self.rejected_s = (self.rejected_s - 2.0 * dt_s).max(0.0);
            1.0
        } else if self.rejected_s < GATE.reject_max_s {
            self.rejected_s += dt_s;
            0.0
        } else {
            GATE.weight_after
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EARTH: Vector3<f64> = Vector3::new(16.0, 0.0, -41.0);

    #[test]
    fn a_magnet_is_rejected_for_a_limited_time() {
        let mut gate = FieldGate::default();
        for _ in 0..500 {
            assert_eq!(gate.update(&EARTH, 0.0, 0.01), 1.0);
        }
        let magnet = EARTH + Vector3::new(0.0, 25.0, 10.0);
        for _ in 0..5900 {
            assert_eq!(gate.update(&magnet, 0.0, 0.01), 0.0);
        }
        assert!(gate.disturbed);
        for _ in 0..200 {
            gate.update(&magnet, 0.0, 0.01);
        }
        assert_eq!(
            gate.update(&magnet, 0.0, 0.01),
            0.5,
            "the rejection is limited"
        );
        for _ in 0..60 {
            gate.update(&EARTH, 0.0, 0.01);
        }
        assert_eq!(gate.update(&EARTH, 0.0, 0.01), 1.0);
    }

    #[test]
    fn a_new_field_is_accepted_only_while_turning() {
        let room = Vector3::new(22.0, 0.0, -52.0);
        for (turning, accepted) in [(0.0, false), (1.0, true)] {
            let mut gate = FieldGate::default();
            for _ in 0..200 {
                gate.update(&EARTH, turning, 0.01);
            }
            for _ in 0..2500 {
                gate.update(&room, turning, 0.01);
            }
            assert_eq!(!gate.disturbed, accepted, "turning at {turning} rad/s");
        }
    }
}
