//! The magnetic field: when to believe it.
//!
//! Strength and dip are compared with a slow reference, and a field that differs is refused, for a
//! bounded time; a different field that stays the same while the sensor turns becomes the new
//! reference (after Laidig & Seel 2023, section 3.6). Strength and dip can be told without knowing
//! the heading, which is what is at stake.

use super::intake::share;
use super::limits::{self, OutOfRange};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// When is the magnetic field the Earth's?
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FieldConfig {
    /// Largest relative difference of the field's strength from the reference. Default 0.1. Bigger:
    /// weaker disturbances pass, a good field is refused less often.
    pub strength_share: f64,
    /// Largest difference of the dip angle from the reference, degrees. Default 10. Bigger: as above.
    pub dip_deg: f64,
    /// Time constant with which the reference follows an accepted field, seconds. Default 20. Bigger:
    /// a creeping disturbance is noticed later, but the reference is steadier.
    pub reference_tau_s: f64,
    /// How long the field must agree before it is believed again, seconds. Default 0.5. Bigger: a
    /// disturbance that passes through the reference's values is less often believed.
    pub regain_s: f64,
    /// Longest full refusal, seconds. Default 60. Bigger: the heading drifts longer on the gyroscope
    /// before a disturbed field is better than none.
    pub refuse_max_s: f64,
    /// Weight of a field that is still disturbed after that, 0 to 1. Default 0.5. Bigger: the
    /// heading follows a disturbed field sooner.
    pub refuse_after_weight: f64,
    /// How long another field must stay the same to become the reference, seconds of turning.
    /// Default 20. Bigger: moving into another room takes longer to accept.
    pub accept_s: f64,
    /// Turning rate that counts as turning, °/s. Default 20. Bigger: only brisk turning proves a field.
    pub turning_deg_s: f64,
}

impl Default for FieldConfig {
    fn default() -> Self {
        Self {
            strength_share: 0.1,
            dip_deg: 10.0,
            reference_tau_s: 20.0,
            regain_s: 0.5,
            refuse_max_s: 60.0,
            refuse_after_weight: 0.5,
            accept_s: 20.0,
            turning_deg_s: 20.0,
        }
    }
}

impl FieldConfig {
    /// Refuses settings that are not finite or far from anything sensible.
    ///
    /// # Errors
    /// The first setting that is out of range, with its range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        let d = Self::default();
        let rows = [
            ("strength_share", self.strength_share, d.strength_share, 0.001, 10.0),
            ("dip_deg", self.dip_deg, d.dip_deg, 0.1, 180.0),
            ("reference_tau_s", self.reference_tau_s, d.reference_tau_s, 0.01, 10_000.0),
            ("regain_s", self.regain_s, d.regain_s, 0.0, 1000.0),
            ("refuse_max_s", self.refuse_max_s, d.refuse_max_s, 0.0, 100_000.0),
            ("refuse_after_weight", self.refuse_after_weight, d.refuse_after_weight, 0.0, 1.0),
            ("accept_s", self.accept_s, d.accept_s, 0.0, 100_000.0),
            ("turning_deg_s", self.turning_deg_s, d.turning_deg_s, 0.0, 10_000.0),
        ];
        limits::check(&rows)
    }
}

/// Strength (µT) and dip (rad, + when the field points down) of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldShape {
    /// Strength, µT.
    pub strength_ut: f64,
    /// Dip below the horizon, rad.
    pub dip_rad: f64,
}

impl FieldShape {
    /// Shape of a field given in the world frame, µT.
    #[must_use]
    pub fn of(field_world: &Vector3<f64>) -> Self {
        Self { strength_ut: field_world.norm(), dip_rad: (-field_world.z).atan2(field_world.xy().norm()) }
    }
    fn near(&self, other: &Self, config: &FieldConfig) -> bool {
        (self.strength_ut - other.strength_ut).abs() < config.strength_share * other.strength_ut
            && (self.dip_rad - other.dip_rad).abs() < config.dip_deg.to_radians()
    }
    fn follow(&mut self, target: &Self, share: f64) {
        self.strength_ut += share * (target.strength_ut - self.strength_ut);
        self.dip_rad += share * (target.dip_rad - self.dip_rad);
    }
}

/// Accepts or refuses the magnetic field.
#[derive(Debug, Clone, Copy)]
pub struct FieldGate {
    config: FieldConfig,
    shapes: Option<Shapes>,
    agreed_s: f64,
    refused_s: f64,
    disturbed: bool,
}

/// The believed field and the one that may replace it.
#[derive(Debug, Clone, Copy)]
struct Shapes {
    reference: FieldShape,
    candidate: FieldShape,
    candidate_s: f64,
}

impl FieldGate {
    /// A gate that will believe the first field it sees.
    #[must_use]
    pub fn new(config: FieldConfig) -> Self {
        Self { config, shapes: None, agreed_s: 0.0, refused_s: 0.0, disturbed: false }
    }
    /// True while the field is not the reference.
    #[must_use]
    pub fn disturbed(&self) -> bool {
        self.disturbed
    }
    /// Takes the field in the world frame (µT), the turning rate (rad/s) and the time since the last
    /// field; returns the weight, 0 to 1, that its heading deserves.
    pub fn update(&mut self, field_world: &Vector3<f64>, turning_rad_s: f64, dt_s: f64) -> f64 {
        let now = FieldShape::of(field_world);
        let first = Shapes { reference: now, candidate: now, candidate_s: 0.0 };
        let mut shapes = self.shapes.unwrap_or(first);
        self.compare(&mut shapes, &now, dt_s);
        self.try_candidate(&mut shapes, &now, turning_rad_s, dt_s);
        self.shapes = Some(shapes);
        self.weigh(dt_s)
    }

    fn compare(&mut self, shapes: &mut Shapes, now: &FieldShape, dt_s: f64) {
        if !now.near(&shapes.reference, &self.config) {
            self.agreed_s = 0.0;
            self.disturbed = true;
            return;
        }
        self.agreed_s += dt_s;
        if self.agreed_s >= self.config.regain_s {
            self.disturbed = false;
            shapes.reference.follow(now, share(dt_s, self.config.reference_tau_s));
        }
    }

    fn try_candidate(&mut self, shapes: &mut Shapes, now: &FieldShape, turning_rad_s: f64, dt_s: f64) {
        if !now.near(&shapes.candidate, &self.config) {
            (shapes.candidate, shapes.candidate_s) = (*now, 0.0);
            return;
        }
        shapes.candidate.follow(now, share(dt_s, self.config.reference_tau_s));
        if turning_rad_s >= self.config.turning_deg_s.to_radians() {
            shapes.candidate_s += dt_s;
        }
        if self.disturbed && shapes.candidate_s >= self.config.accept_s {
            shapes.reference = shapes.candidate;
            self.agreed_s = self.config.regain_s;
            self.disturbed = false;
        }
    }

    fn weigh(&mut self, dt_s: f64) -> f64 {
        if !self.disturbed {
            self.refused_s = (self.refused_s - 2.0 * dt_s).max(0.0);
            1.0
        } else if self.refused_s < self.config.refuse_max_s {
            self.refused_s += dt_s;
            0.0
        } else {
            self.config.refuse_after_weight
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EARTH: Vector3<f64> = Vector3::new(16.0, 0.0, -41.0);

    #[test]
    fn a_magnet_is_refused_then_tolerated_then_forgotten() {
        let mut gate = FieldGate::new(FieldConfig::default());
        for _ in 0..500 {
            assert_eq!(gate.update(&EARTH, 0.0, 0.01), 1.0);
        }
        let magnet = EARTH + Vector3::new(0.0, 25.0, 10.0);
        for _ in 0..5900 {
            assert_eq!(gate.update(&magnet, 0.0, 0.01), 0.0);
        }
        assert!(gate.disturbed());
        for _ in 0..200 {
            gate.update(&magnet, 0.0, 0.01);
        }
        assert_eq!(gate.update(&magnet, 0.0, 0.01), 0.5, "refusal is bounded");
        for _ in 0..60 {
            gate.update(&EARTH, 0.0, 0.01);
        }
        assert_eq!(gate.update(&EARTH, 0.0, 0.01), 1.0);
    }

    #[test]
    fn another_room_is_accepted_only_when_turned_in() {
        let room = Vector3::new(22.0, 0.0, -52.0);
        for (turning, accepted) in [(0.0, false), (1.0, true)] {
            let mut gate = FieldGate::new(FieldConfig::default());
            for _ in 0..200 {
                gate.update(&EARTH, turning, 0.01);
            }
            for _ in 0..2500 {
                gate.update(&room, turning, 0.01);
            }
            assert_eq!(!gate.disturbed(), accepted, "turning at {turning} rad/s");
        }
    }
}
