//! The table of everything that can be wrong with a plant, by name.
//!
//! `[effects.NAME]` are the causes of the diagnosis catalogue, made here in forms of their own;
//! `[effects.outside.NAME]` are causes that the catalogue does not hold. A table that is absent, or
//! whose size is 0, leaves the plant bit for bit as it was.

use crate::simulation::plant::base::BaseMotion;
use crate::simulation::plant::bellows::asymmetry::Asymmetry;
use crate::simulation::plant::bellows::bubble_jump::BubbleJump;
use crate::simulation::plant::bellows::creep::Creep;
use crate::simulation::plant::bellows::hysteresis::Hysteresis;
use crate::simulation::plant::bellows::ringing::Ringing;
use crate::simulation::plant::bellows::snap_through::SnapThrough;
use crate::simulation::plant::bellows::softening::Softening;
use crate::simulation::plant::bellows::stiffening::Stiffening;
use crate::simulation::plant::check::PlantError;
use crate::simulation::plant::drive::gear_periodic::GearPeriodic;
use crate::simulation::plant::drive::missed_steps::MissedSteps;
use crate::simulation::plant::drive::stick_slip::StickSlip;
use crate::simulation::plant::imu::accel_bias::AccelBias;
use crate::simulation::plant::imu::gyro_bias::GyroBias;
use crate::simulation::plant::imu::hard_iron::HardIron;
use crate::simulation::plant::imu::motor_field::MotorField;
use crate::simulation::plant::imu::mount_misalignment::MountMisalignment;
use crate::simulation::plant::imu::scale::{AccScale, GSensitivity, GyroScale, SoftIron};
use crate::simulation::plant::line::crosstalk::Crosstalk;
use crate::simulation::plant::line::gas_compression::GasCompression;
use crate::simulation::plant::line::leak::Leak;
use crate::simulation::plant::line::line_lag::LineLag;
use crate::simulation::plant::line::play::PlayWear;
use crate::simulation::plant::line::rate_coupling::RateCoupling;
use crate::simulation::plant::line::thermal_drift::ThermalDrift;
use crate::simulation::plant::plant_effect::PlantEffect;
use crate::simulation::plant::rng::PlantRng;
use crate::simulation::plant::shape::cable_stiffness::CableStiffness;
use crate::simulation::plant::shape::clocking::Clocking;
use crate::simulation::plant::shape::contact::Contact;
use crate::simulation::plant::shape::curvature::Curvature;
use crate::simulation::plant::shape::gravity::Gravity;
use crate::simulation::plant::shape::length_gain::LengthGain;
use crate::simulation::plant::shape::torsion::Torsion;
use crate::simulation::plant::shape::twist_creep::TwistCreep;
use crate::simulation::plant::timing::{ClockDrift, SensorFreeze, SensorLatency, TransportDelay};
use serde::{Deserialize, Serialize};

/// Name of an effect that the plant can make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EffectName {
    /// As in `[effects.NAME]` or `[effects.outside.NAME]`; unique over both.
    pub name: &'static str,
    /// Stage of the chain that it acts in.
    pub stage: &'static str,
    /// Whether the diagnosis catalogue holds it.
    pub in_catalogue: bool,
}

macro_rules! causes {
    (
        $(#[$doc:meta])* $table:ident, in_catalogue = $inside:literal, names = $names:ident,
        { $( $name:ident: $kind:ty, $stage:literal, $what:literal; )* }
        $( $(#[$nested_doc:meta])* nested $nested:ident: $nested_kind:ty )?
    ) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $table {
            $( #[doc = $what] #[serde(skip_serializing_if = "Option::is_none")] pub $name: Option<$kind>, )*
            $( $(#[$nested_doc])* pub $nested: $nested_kind, )?
        }

        const $names: &[EffectName] = &[
            $( EffectName { name: stringify!($name), stage: $stage, in_catalogue: $inside }, )*
        ];

        impl $table {
            fn check(&self) -> Result<(), PlantError> {
                $( if let Some(cause) = &self.$name { cause.check()?; } )*
                Ok(())
            }
            /// Draws the named cause; false if this table has none of the name.
            fn draw(&mut self, name: &str, severity: f64, rng: &mut PlantRng) -> bool {
                match name {
                    $( stringify!($name) => self.$name = Some(<$kind>::draw(severity, rng)), )*
                    _ => return false,
                }
                true
            }
            /// Makes every cause bigger or smaller by a factor of its own.
            fn vary(&mut self, sigma: f64, rng: &mut PlantRng) {
                $( if let Some(cause) = &mut self.$name { cause.scale(rng.factor(sigma)); } )*
            }
        }
    };
}

causes! {
    /// `[effects]`: causes of the catalogue.
    Effects, in_catalogue = true, names = CATALOGUE,
    {
        missed_steps: MissedSteps, "drive", "A motor loses steps.";
        gear_periodic: GearPeriodic, "drive", "Tooth error of rack and pinion.";
        leak: Leak, "transmission", "A line loses its air.";
        gas_compression: GasCompression, "transmission", "The air spring stiffens with pressure.";
        line_lag: LineLag, "transmission", "Flow through the lumen takes time.";
        thermal_drift: ThermalDrift, "transmission", "Air warms up.";
        crosstalk: Crosstalk, "transmission", "Lumens squeeze each other.";
        stiffening: Stiffening, "bellows", "Rubber hardens with stretch.";
        asymmetry: Asymmetry, "bellows", "Elongation and contraction differ.";
        hysteresis: Hysteresis, "bellows", "Memory without time.";
        creep: Creep, "bellows", "Rubber gives way in holds.";
        softening: Softening, "bellows", "First stretches soften the rubber.";
        gravity: Gravity, "shape", "The tip sags.";
        curvature: Curvature, "shape", "More or less bend than constant curvature.";
        clocking: Clocking, "shape", "Bellows off their places.";
        cable_stiffness: CableStiffness, "shape", "A cable makes bending anisotropic.";
        torsion: Torsion, "shape", "Bending twists.";
        contact: Contact, "shape", "A wall stops the tip.";
        gyro_bias: GyroBias, "sensor", "The gyroscope drifts.";
        accel_bias: AccelBias, "sensor", "The accelerometer is off.";
        hard_iron: HardIron, "sensor", "Magnets turn with the sensor.";
        motor_field: MotorField, "sensor", "The motors' coils are felt.";
        mount_misalignment: MountMisalignment, "sensor", "The chip sits askew.";
        transport_delay: TransportDelay, "timing", "Commands arrive late.";
        sensor_latency: SensorLatency, "timing", "Samples arrive late.";
        base_motion: BaseMotion, "base", "The base turns.";
    }
    /// Causes that the catalogue does not hold.
    nested outside: Outside
}

causes! {
    /// `[effects.outside]`: causes that the diagnosis catalogue does not hold.
    Outside, in_catalogue = false, names = OUTSIDE,
    {
        stick_slip: StickSlip, "drive", "The plunger sticks and jumps.";
        play_wear: PlayWear, "transmission", "Play grows with use.";
        rate_coupling: RateCoupling, "transmission", "A moving channel drags the next.";
        bubble_jump: BubbleJump, "transmission", "A bubble moves.";
        snap_through: SnapThrough, "bellows", "A fold pops.";
        ringing: Ringing, "bellows", "The tip rings.";
        length_gain: LengthGain, "shape", "A longer tip bends more.";
        twist_creep: TwistCreep, "shape", "A held bend unscrews the tip.";
        gyro_scale: GyroScale, "sensor", "The gyroscope's scale is off.";
        g_sensitivity: GSensitivity, "sensor", "The gyroscope feels gravity.";
        acc_scale: AccScale, "sensor", "The accelerometer's scale is off.";
        soft_iron: SoftIron, "sensor", "Iron stretches the field.";
        clock_drift: ClockDrift, "timing", "The sensor's clock runs off.";
        sensor_freeze: SensorFreeze, "timing", "The sensor hangs.";
    }
}

impl Effects {
    pub(crate) fn validate(&self) -> Result<(), PlantError> {
        self.check()?;
        self.outside.check()
    }
    /// Sets the named cause to a random one of its typical range; false if there is no such name.
    pub(crate) fn choose(&mut self, name: &str, severity: f64, rng: &mut PlantRng) -> bool {
        self.draw(name, severity, rng) || self.outside.draw(name, severity, rng)
    }
    /// Sizes as another unit of the same make has them.
    pub(crate) fn varied(&self, sigma: f64, rng: &mut PlantRng) -> Self {
        let mut unit = self.clone();
        unit.vary(sigma, rng);
        unit.outside.vary(sigma, rng);
        unit
    }
}

/// Every effect that the plant can make: the catalogue's first, in its order, then those outside.
pub fn effect_names() -> impl Iterator<Item = &'static EffectName> {
    CATALOGUE.iter().chain(OUTSIDE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_catalogues_and_unique() {
        assert_eq!(CATALOGUE.len(), 26);
        assert!(OUTSIDE.len() >= 8);
        let all: std::collections::BTreeSet<_> = effect_names().map(|e| e.name).collect();
        assert_eq!(all.len(), CATALOGUE.len() + OUTSIDE.len());
    }
}
