//! The list of all effects that the plant can have, and the tables `[effects]` and `[effects.outside]`.
//!
//! `[effects.NAME]` are effects of the diagnosis catalogue, simulated here by laws of another form;
//! `[effects.outside.NAME]` are effects that the catalogue does not contain. A table that is absent, or whose
//! size is 0, leaves the plant unchanged to the last bit.
//!
//! The entry in `table` is all that an effect needs besides its own file.

pub mod acc_scale;
pub mod accel_bias;
pub mod asymmetry;
pub mod base_motion;
pub mod bubble_jump;
pub mod cable_stiffness;
pub mod clock_drift;
pub mod clocking;
pub mod contact;
pub mod creep;
pub mod crosstalk;
pub mod curvature;
pub mod g_sensitivity;
pub mod gas_compression;
pub mod gear_periodic;
pub mod gravity;
pub mod gyro_bias;
pub mod gyro_scale;
pub mod hard_iron;
pub mod hysteresis;
pub mod leak;
pub mod length_gain;
pub mod line_lag;
pub mod missed_steps;
pub mod motor_field;
pub mod mount_misalignment;
pub mod play_wear;
pub mod rate_coupling;
pub mod respiration;
pub mod ringing;
pub mod sensor_freeze;
pub mod sensor_latency;
pub mod snap_through;
pub mod soft_iron;
pub mod softening;
pub mod stick_slip;
pub mod stiffening;
pub mod thermal_drift;
pub mod torsion;
pub mod transport_delay;
pub mod twist_creep;

use crate::primitives::Invalid;
use crate::simulation::plant::law::{Law, Laws, PlantEffect, UnitData};
use crate::simulation::plant::parameters::Table;
use crate::simulation::plant::rng::PlantRng;
use serde::{Deserialize, Serialize};

/// Name of an effect that the plant can have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EffectName {
    /// As in `[effects.NAME]` or `[effects.outside.NAME]`; unique over both.
    pub name: &'static str,
    /// Stage of the chain that the effect acts in.
    pub stage: &'static str,
    /// Whether the diagnosis catalogue contains it.
    pub in_catalogue: bool,
}

/// Defines a table of optional effects from their names, and what is done with all of them in turn. `at` is the place among
/// the laws that act at one point of the chain, 10 by default: smaller ones act first, equal ones in the order of the list.
macro_rules! table {
    (@order) => { 10 };
    (@order $order:literal) => { $order };
    ($(#[$doc:meta])* $table:ident, $names:ident, $in_catalogue:literal, { $($name:ident: $kind:ident in $stage:literal $(at $order:literal)?,)* } $($nested:ident: $nested_kind:ident)?) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $table {
            $(
                #[doc = concat!("See [`", stringify!($name), "`].")]
                #[serde(skip_serializing_if = "Option::is_none")]
                pub $name: Option<$name::$kind>,
            )*
            $( #[doc = "Effects that the diagnosis catalogue does not contain."] pub $nested: $nested_kind, )?
        }

        const $names: &[EffectName] = &[
            $( EffectName { name: stringify!($name), stage: $stage, in_catalogue: $in_catalogue }, )*
        ];

        impl $table {
            /// Refuses parameters outside their ranges.
            pub(crate) fn check(&self) -> Result<(), Invalid> {
                $( if let Some(effect) = &self.$name { effect.check().and_then(|()| effect.consistent())?; } )*
                $( self.$nested.check()?; )?
                Ok(())
            }
            /// Sets the named effect to a random one of its typical range; false if there is no such name.
            pub(crate) fn draw(&mut self, name: &str, severity: f64, rng: &mut PlantRng) -> bool {
                match name {
                    $( stringify!($name) => self.$name = Some(PlantEffect::draw(severity, rng)), )*
                    _ => return false $(|| self.$nested.draw(name, severity, rng))?,
                }
                true
            }
            /// Scales every effect that is present by a random factor of its own.
            pub(crate) fn vary(&mut self, sigma: f64, rng: &mut PlantRng) {
                $( if let Some(effect) = &mut self.$name { effect.scale(rng.factor(sigma)); } )*
                $( self.$nested.vary(sigma, rng); )?
            }
            /// The imperfections of a real unit, all of them.
            #[allow(clippy::needless_update)] // the table of the catalogue has one more field than its effects
            fn imperfections(up_to: &mut dyn FnMut(f64) -> f64) -> Self {
                Self { $( $name: PlantEffect::background(up_to), )* ..Self::default() }
            }
            /// Takes each effect of `other` with even odds, unless it is set already.
            fn fill(&mut self, other: Self, rng: &mut PlantRng) {
                $( if other.$name.is_some() && rng.chance(0.5) && self.$name.is_none() { self.$name = other.$name; } )*
            }
            /// Adds the laws of all effects of a size other than 0, each with its place.
            fn add_laws(&self, laws: &mut Vec<(u8, Box<dyn Law>)>, unit: &UnitData) {
                $( if let Some(e) = self.$name.as_ref().filter(|e| e.is_active()) {
                    laws.push((table!(@order $($order)?), e.law(unit)));
                } )*
                $( self.$nested.add_laws(laws, unit); )?
            }
        }
    };
}

table! {
    /// `[effects]`: effects of the diagnosis catalogue, in its order.
    Effects, CATALOGUE, true,
    {
        missed_steps: MissedSteps in "drive",
        gear_periodic: GearPeriodic in "drive",
        leak: Leak in "transmission" at 20,
        gas_compression: GasCompression in "transmission",
        line_lag: LineLag in "transmission",
        thermal_drift: ThermalDrift in "transmission",
        crosstalk: Crosstalk in "transmission",
        stiffening: Stiffening in "bellows",
        asymmetry: Asymmetry in "bellows",
        hysteresis: Hysteresis in "bellows",
        creep: Creep in "bellows",
        softening: Softening in "bellows",
        gravity: Gravity in "shape" at 20,
        curvature: Curvature in "shape",
        clocking: Clocking in "shape",
        cable_stiffness: CableStiffness in "shape",
        torsion: Torsion in "shape",
        contact: Contact in "shape",
        gyro_bias: GyroBias in "sensor",
        accel_bias: AccelBias in "sensor",
        hard_iron: HardIron in "sensor" at 20,
        motor_field: MotorField in "sensor",
        mount_misalignment: MountMisalignment in "sensor" at 0,
        transport_delay: TransportDelay in "timing",
        sensor_latency: SensorLatency in "timing",
        base_motion: BaseMotion in "base",
    }
    outside: Outside
}

table! {
    /// `[effects.outside]`: effects that the diagnosis catalogue does not contain.
    Outside, OUTSIDE, false,
    {
        stick_slip: StickSlip in "drive",
        play_wear: PlayWear in "transmission",
        rate_coupling: RateCoupling in "transmission" at 0,
        bubble_jump: BubbleJump in "transmission",
        snap_through: SnapThrough in "bellows",
        ringing: Ringing in "bellows",
        length_gain: LengthGain in "shape" at 0,
        twist_creep: TwistCreep in "shape",
        gyro_scale: GyroScale in "sensor" at 1,
        g_sensitivity: GSensitivity in "sensor" at 2,
        acc_scale: AccScale in "sensor" at 3,
        soft_iron: SoftIron in "sensor" at 0,
        clock_drift: ClockDrift in "timing",
        sensor_freeze: SensorFreeze in "timing",
        respiration: Respiration in "shape",
    }
}

impl Effects {
    /// Adds the imperfections that no real unit is without, each with even odds. What is set is left alone.
    pub(crate) fn add_background(&mut self, rng: &mut PlantRng) {
        let imperfections = Self::imperfections(&mut |size| size * rng.between(0.3, 1.0));
        self.fill(imperfections, rng);
        let outside = Outside::imperfections(&mut |size| size * rng.between(0.3, 1.0));
        self.outside.fill(outside, rng);
    }
    /// The laws of all effects of a size other than 0, in the order in which they act.
    pub(crate) fn laws(&self, unit: &UnitData) -> Laws {
        let mut laws = Vec::new();
        self.add_laws(&mut laws, unit);
        laws.sort_by_key(|(order, _)| *order);
        laws.into_iter().map(|(_, law)| law).collect()
    }
}

/// Every effect that the plant can have: those of the catalogue first, in its order, then those outside.
pub fn effect_names() -> impl Iterator<Item = &'static EffectName> {
    CATALOGUE.iter().chain(OUTSIDE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::catalogue;

    #[test]
    fn the_list_begins_with_the_catalogue() {
        let catalogue: Vec<_> = catalogue()
            .iter()
            .map(|e| (e.name(), e.stage().name()))
            .collect();
        let names: Vec<_> = CATALOGUE.iter().map(|e| (e.name, e.stage)).collect();
        assert_eq!(names, catalogue);
        let all: std::collections::BTreeSet<_> = effect_names().map(|e| e.name).collect();
        assert_eq!(all.len(), CATALOGUE.len() + OUTSIDE.len());
    }
}
