//! Plants for blind exams: one effect of a random plausible size, and the small imperfections that no
//! real unit is without.

use crate::simulation::plant::bellows::asymmetry::Asymmetry;
use crate::simulation::plant::bellows::creep::Creep;
use crate::simulation::plant::bellows::hysteresis::Hysteresis;
use crate::simulation::plant::bellows::softening::Softening;
use crate::simulation::plant::bellows::stiffening::Stiffening;
use crate::simulation::plant::check::PlantError;
use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::drive::gear_periodic::GearPeriodic;
use crate::simulation::plant::effects::{Effects, effect_names};
use crate::simulation::plant::imu::accel_bias::AccelBias;
use crate::simulation::plant::imu::hard_iron::HardIron;
use crate::simulation::plant::imu::motor_field::MotorField;
use crate::simulation::plant::imu::mount_misalignment::MountMisalignment;
use crate::simulation::plant::line::crosstalk::Crosstalk;
use crate::simulation::plant::line::gas_compression::GasCompression;
use crate::simulation::plant::line::leak::Leak;
use crate::simulation::plant::line::thermal_drift::ThermalDrift;
use crate::simulation::plant::rng::{PlantRng, Stream};
use crate::simulation::plant::shape::cable_stiffness::CableStiffness;
use crate::simulation::plant::shape::clocking::Clocking;
use crate::simulation::plant::shape::curvature::Curvature;
use crate::simulation::plant::shape::gravity::Gravity;
use crate::simulation::plant::shape::torsion::Torsion;
use rand::Rng;

impl PlantConfig {
    /// The same plant with the named effect at a random size of its typical range: the small end at
    /// severity 0, the big end at 1. Where an effect has a channel, a direction or a moment, that is
    /// random too.
    ///
    /// # Errors
    /// [`PlantError::UnknownEffect`] for a name that [`effect_names`] does not list.
    pub fn with_effect<R: Rng + ?Sized>(mut self, name: &str, severity: f64, rng: &mut R) -> Result<Self, PlantError> {
        let mut rng = PlantRng::new(rng.next_u64(), Stream::Choice);
        if self.effects.choose(name, severity, &mut rng) {
            return Ok(self);
        }
        let known = effect_names().map(|e| e.name).collect::<Vec<_>>().join(", ");
        Err(PlantError::UnknownEffect { name: name.to_owned(), known })
    }

    /// The same plant with the small imperfections that no real unit is without, each below 0.15° of
    /// tip orientation and each there with even odds. What is set already is left alone.
    #[must_use]
    pub fn background<R: Rng + ?Sized>(mut self, rng: &mut R) -> Self {
        let mut rng = PlantRng::new(rng.next_u64(), Stream::Choice);
        let e = &mut self.effects;
        let mut tenth = |size: f64| size * rng.between(0.3, 1.0);
        let small = Effects {
            gear_periodic: Some(GearPeriodic { amplitude_mm: tenth(0.01), ..GearPeriodic::default() }),
            leak: Some(Leak { rate_per_s: [0; 3].map(|_| tenth(5e-5)), ..Leak::default() }),
            gas_compression: Some(GasCompression { strength: tenth(0.012), ..GasCompression::default() }),
            thermal_drift: Some(ThermalDrift { offset_mm: [tenth(0.02), -tenth(0.02), 0.0], ..ThermalDrift::default() }),
            crosstalk: Some(Crosstalk { share: tenth(0.0015), ..Crosstalk::default() }),
            stiffening: Some(Stiffening { share: tenth(0.003), ..Stiffening::default() }),
            asymmetry: Some(Asymmetry { share: tenth(0.003), ..Asymmetry::default() }),
            hysteresis: Some(Hysteresis { share: tenth(0.006), ..Hysteresis::default() }),
            creep: Some(Creep { share: tenth(0.002), ..Creep::default() }),
            softening: Some(Softening { share: tenth(0.003), ..Softening::default() }),
            gravity: Some(Gravity { sag_deg: tenth(0.1), ..Gravity::default() }),
            curvature: Some(Curvature { excess_deg: tenth(0.1) }),
            clocking: Some(Clocking { offset_deg: [tenth(0.08), -tenth(0.08), tenth(0.08)], ..Clocking::default() }),
            cable_stiffness: Some(CableStiffness { share: tenth(0.0015), direction_deg: tenth(180.0), ..CableStiffness::default() }),
            torsion: Some(Torsion { twist_deg: tenth(0.1), direction_deg: 0.0 }),
            accel_bias: Some(AccelBias { bias_mg: [0; 3].map(|_| tenth(1.0)) }),
            hard_iron: Some(HardIron { offset_ut: [0; 3].map(|_| tenth(0.06)), ..HardIron::default() }),
            motor_field: Some(MotorField { amplitude_ut: [0; 3].map(|_| tenth(0.02)), ..MotorField::default() }),
            mount_misalignment: Some(MountMisalignment { tilt_deg: [0; 3].map(|_| tenth(0.06)), ..MountMisalignment::default() }),
            ..Effects::default()
        };
        e.fill(small, &mut rng);
        self
    }
}

impl Effects {
    /// Takes each cause of `small` that is not set here, with even odds.
    fn fill(&mut self, small: Effects, rng: &mut PlantRng) {
        macro_rules! take {
            ($($name:ident),*) => { $(
                let wanted = rng.chance(0.5);
                if wanted && self.$name.is_none() { self.$name = small.$name; }
            )* };
        }
        take!(
            gear_periodic,
            leak,
            gas_compression,
            thermal_drift,
            crosstalk,
            stiffening,
            asymmetry,
            hysteresis,
            creep,
            softening,
            gravity,
            curvature,
            clocking,
            cable_stiffness,
            torsion,
            accel_bias,
            hard_iron,
            motor_field,
            mount_misalignment
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand::rngs::Xoshiro256PlusPlus;

    #[test]
    fn every_draw_is_valid_and_survives_toml() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        for e in effect_names() {
            for severity in [0.0, 0.5, 1.0] {
                for _ in 0..20 {
                    let config = PlantConfig::default().with_effect(e.name, severity, &mut rng).unwrap();
                    config.validate().unwrap();
                    assert_ne!(config, PlantConfig::default(), "{}", e.name);
                    let text = toml::to_string(&config).unwrap();
                    assert_eq!(toml::from_str::<PlantConfig>(&text).unwrap(), config);
                }
            }
        }
        let why = PlantConfig::default().with_effect("gremlins", 0.5, &mut rng).unwrap_err();
        assert!(why.to_string().contains("gremlins") && why.to_string().contains("torsion"));
    }

    #[test]
    fn a_background_leaves_what_is_set() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(2);
        let set = PlantConfig::default().with_effect("creep", 1.0, &mut rng).unwrap();
        for _ in 0..20 {
            let config = set.clone().background(&mut rng);
            config.validate().unwrap();
            assert_eq!(config.effects.creep, set.effects.creep);
            assert!(config.effects.outside == set.effects.outside);
        }
    }
}
