//! What an effect of the plant is: its parameters, its random draws, and its law in the chain.
//!
//! A running effect is a [`Law`]: a place in the chain is one method, which an effect overrides where it acts.
//! The stages call every law at every place, in the order that the table of all effects states.

use crate::primitives::{Invalid, Rotation, World};
use crate::simulation::plant::fault::Faults;
use crate::simulation::plant::imu::stimulus::Stimulus;
use crate::simulation::plant::parameters::Table;
use crate::simulation::plant::rng::PlantRng;
use crate::simulation::plant::shape::arc::Plate;
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// An effect beyond the nominal machine, as its parameters describe it. `effect!` implements it.
pub(crate) trait PlantEffect: Table + Default + Sized {
    /// Size of the imperfection that every real unit may have; 0 for an effect that only faulty units have.
    const BACKGROUND: f64 = 0.0;
    /// The running law of this effect, at its start.
    fn law(&self, unit: &UnitData) -> Box<dyn Law>;
    /// A random effect of plausible size: the small end of the typical range at severity 0, the large end at 1.
    fn draw(severity: f64, rng: &mut PlantRng) -> Self;
    /// That imperfection, with every size of the effect drawn. `up_to` draws 0.3 to 1 times its argument.
    fn background(up_to: &mut dyn FnMut(f64) -> f64) -> Option<Self> {
        (Self::BACKGROUND > 0.0).then(|| {
            let mut effect = Self::default();
            let sizes = effect.sizes().into_iter().flat_map(|(_, numbers)| numbers);
            sizes.for_each(|size| *size = up_to(Self::BACKGROUND));
            effect
        })
    }
    /// Refuses combinations of parameters that are in their ranges one by one.
    ///
    /// # Errors
    /// [`Invalid`] for the first.
    fn consistent(&self) -> Result<(), Invalid> {
        Ok(())
    }
}

/// What a law may depend on besides its own parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct UnitData {
    /// Seed of the plant's random numbers.
    pub(crate) seed: u64,
    /// Piston travel per microstep, mm.
    pub(crate) step_mm: f64,
    /// Microsteps per full step.
    pub(crate) microsteps: f64,
    /// Bellow length at atmospheric pressure, mm.
    pub(crate) rest_length_mm: f64,
    /// Extension gains k_ε for small signals.
    pub(crate) k_epsilon: Vector3<f64>,
}

/// One step of the plant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moment {
    /// Time at the end of the step, s.
    pub(crate) t: f64,
    /// Length of the step, s; at a sensor, the time since its last sample.
    pub(crate) dt_s: f64,
}

/// State of the bellows that reaches back into the lines.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct BellowState {
    /// Length changes, mm.
    pub(crate) bellow_mm: Vector3<f64>,
    /// Gauge pressures, kPa.
    pub(crate) pressure_kpa: Vector3<f64>,
}

/// The bending section at one moment, besides its bend.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SectionState {
    /// Time at the end of the step, s.
    pub(crate) t: f64,
    /// Centre length, mm.
    pub(crate) length_mm: f64,
    /// Centre length beyond the rest length, mm.
    pub(crate) longer_mm: f64,
    /// Attitude of the proximal plate.
    pub(crate) r_world_plate: Rotation<World, Plate>,
}

/// A running effect. The methods are the places of the chain, from command to sample.
pub(crate) trait Law: std::fmt::Debug + Send {
    /// Microstep counts on their way to the motors.
    fn command(&mut self, _counts: &mut Vector3<f64>, _at: &Moment) {}
    /// Microsteps by which the rotors turn in this step.
    fn rotor(&mut self, _turned: &mut Vector3<f64>, _at: &Moment) {}
    /// Positions of the racks, then of the plungers, mm.
    fn rack(&mut self, _rack_mm: &mut Vector3<f64>, _at: &Moment) {}
    /// Half-widths of the play, mm, with the plungers at `plunger_mm`.
    fn play(&mut self, _half_width_mm: &mut Vector3<f64>, _plunger_mm: &Vector3<f64>) {}
    /// Air in the lines, mm of piston.
    fn air(&mut self, _air_mm: &mut Vector3<f64>, _bellows: &BellowState, _at: &Moment) {}
    /// Air that arrives at the bellows, mm of piston.
    fn flow(&mut self, _air_mm: &mut Vector3<f64>, _at: &Moment) {}
    /// The lines are opened for a moment with the pistons at zero.
    fn vent(&mut self) {}
    /// Factors on the compliance of the air in each line at time `t`.
    fn compliance(&self, _compliance: &mut Vector3<f64>, _t: f64) {}
    /// Factors on the stiffness of the walls, given the last length changes.
    fn softening(&mut self, _stiffness: &mut Vector3<f64>, _bellow_mm: &Vector3<f64>) {}
    /// In place of a linear air spring: the pressure at which that spring would have the same strain, kPa, and
    /// its slope.
    fn gas(&self, _pressure_kpa: f64) -> Option<(f64, f64)> {
        None
    }
    /// Wall force in addition to the linear one, over the linear stiffness, mm, and its slope.
    fn wall(&self, _q_mm: f64) -> Option<(f64, f64)> {
        None
    }
    /// Length changes of the bellows, mm, before the mechanical lag.
    fn bellows(&mut self, _q_mm: &mut Vector3<f64>, _at: &Moment) {}
    /// Length changes of the bellows, mm, after the mechanical lag.
    fn lagged(&mut self, _q_mm: &mut Vector3<f64>, _at: &Moment) {}
    /// Angles by which the bellows are off their places, rad.
    fn offsets(&self, _bellow_mm: &Vector3<f64>) -> Option<[f64; 3]> {
        None
    }
    /// Bend vector, rad.
    fn bend(&mut self, _bend: &mut Vector2<f64>, _section: &SectionState) {}
    /// Bend vector at a wall, rad; true if the wall touches.
    fn contact(&mut self, _bend: &mut Vector2<f64>, _at: &Moment) -> bool {
        false
    }
    /// A wall that was put in the way is taken away.
    fn release(&mut self) {}
    /// Twist about the tip's axis, rad.
    fn twist(&mut self, _bend: &Vector2<f64>, _at: &Moment) -> f64 {
        0.0
    }
    /// Rotation of the base in the world at time `t`.
    fn base(&self, _t: f64) -> Option<UnitQuaternion<f64>> {
        None
    }
    /// Magnetic field at the tip in the world, µT, `dt_s` after the last call.
    fn field(&mut self, _field_ut: &mut Vector3<f64>, _counts: &Vector3<f64>, _dt_s: f64) {}
    /// The first stimulus of the sensor, before any motion.
    fn at_start(&mut self, _stimulus: &Stimulus) {}
    /// The stimulus on its way to the sensor, tip axes.
    fn late(&mut self, _stimulus: &mut Stimulus, _at: &Moment) {}
    /// The stimulus as the sensor transduces it, sensor axes.
    fn sensor(&mut self, _stimulus: &mut Stimulus, _at: &Moment) {}
    /// Time stamp of a sample taken at `t`, s.
    fn clock(&self, t: f64) -> f64 {
        t
    }
    /// True while the sensor repeats its last reading.
    fn hangs(&self, _t: f64) -> bool {
        false
    }
}

/// The effects that run in one plant.
pub(crate) type Laws = Vec<Box<dyn Law>>;

/// Lets every law act, in their order.
pub(crate) fn each(laws: &mut Laws, act: impl FnMut(&mut Box<dyn Law>)) {
    laws.iter_mut().for_each(act);
}

/// One step of the plant, as its stages see it.
pub(crate) struct Step<'a> {
    pub(crate) at: Moment,
    pub(crate) laws: &'a mut Laws,
    pub(crate) faults: &'a Faults,
}
