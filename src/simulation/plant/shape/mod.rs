//! From bellow lengths to how the tip stands on its base plate.
//!
//! `q → bend and length (as really built) → length's hold on the bend → curvature → cable → weight →
//! wall → orientation with twist`. Nominally this is constant curvature.

pub mod arc;
pub mod cable_stiffness;
pub mod clocking;
pub mod contact;
pub mod curvature;
pub mod gravity;
pub mod length_gain;
pub mod torsion;
pub mod twist_creep;

use crate::model::bend::Bend;
use crate::primitives::frames::{Rotation, Tip, World};
use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::plant_effect::active;
use arc::{Plate, Section, Terms};
use cable_stiffness::Cable;
use clocking::Clocking;
use contact::Touching;
use curvature::Curvature;
use gravity::Weight;
use length_gain::LengthGain;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use torsion::Torsion;
use twist_creep::Twisting;

/// The bending section with what it remembers.
#[derive(Debug, Clone)]
pub(crate) struct Shape {
    section: Section,
    clocking: Option<Clocking>,
    length_gain: Option<LengthGain>,
    curvature: Option<Curvature>,
    cable: Option<Cable>,
    weight: Option<Weight>,
    wall: Option<Touching>,
    own_wall: Option<Touching>,
    torsion: Option<Torsion>,
    twisting: Option<Twisting>,
    /// A push on the tip that nobody ordered, as a bend vector, rad.
    pub(crate) push: Vector2<f64>,
}

/// How the tip stands on the plate.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pose {
    /// Orientation, tip to plate.
    pub(crate) r_plate_tip: Rotation<Plate, Tip>,
    bend: Vector2<f64>,
    length_mm: f64,
    /// A wall holds it.
    pub(crate) touched: bool,
}

impl Pose {
    /// Position of the tip on the plate, mm.
    pub(crate) fn tip_mm(&self) -> Vector3<f64> {
        Terms::of(&self.bend).tip_mm(&self.bend, self.length_mm)
    }
}

impl Shape {
    pub(crate) fn new(config: &PlantConfig) -> Self {
        let effects = &config.effects;
        Self {
            section: Section::new(config.shape.r_mm, &config.shape.angle_deg.map(f64::to_radians), config.shape.rest_length_mm),
            clocking: active(effects.clocking.as_ref()),
            length_gain: active(effects.outside.length_gain.as_ref()),
            curvature: active(effects.curvature.as_ref()),
            cable: active(effects.cable_stiffness.as_ref()).map(|c| Cable::new(&c)),
            weight: active(effects.gravity.as_ref()).map(|c| Weight::new(c, config.shape.rest_length_mm)),
            wall: active(effects.contact.as_ref()).map(Touching::new),
            own_wall: active(effects.contact.as_ref()).map(Touching::new),
            torsion: active(effects.torsion.as_ref()),
            twisting: active(effects.outside.twist_creep.as_ref()).map(Twisting::new),
            push: Vector2::zeros(),
        }
    }

    /// The pose after `dt_s` with bellow length changes `bellow_mm`, the plate held as given.
    pub(crate) fn step(&mut self, bellow_mm: &Vector3<f64>, r_world_plate: &Rotation<World, Plate>, dt_s: f64) -> Pose {
        let (mut bend, length_mm) = match &self.clocking {
            Some(clocking) => self.section.turned(&clocking.angles(bellow_mm)).shape(bellow_mm),
            None => self.section.shape(bellow_mm),
        };
        if let Some(gain) = &self.length_gain {
            bend *= gain.factor(length_mm - self.section.rest_length_mm);
        }
        if let Some(curvature) = &self.curvature {
            bend = curvature.bent(&bend);
        }
        if let Some(cable) = &self.cable {
            bend -= cable.held_back(&bend);
        }
        if let Some(weight) = &mut self.weight {
            bend = weight.sagged(&bend, length_mm, r_world_plate);
        }
        bend += self.push;
        let mut touched = false;
        if let Some(wall) = &mut self.wall {
            (bend, touched) = wall.step(&bend);
        }
        Pose { r_plate_tip: self.oriented(&bend, dt_s), bend, length_mm, touched }
    }

    /// Puts a wall in the way, or gives back the one that the configuration has.
    pub(crate) fn stand_in_the_way(&mut self, wall: Option<Touching>) {
        self.wall = wall.or_else(|| self.own_wall.clone());
    }

    fn oriented(&mut self, bend: &Vector2<f64>, dt_s: f64) -> Rotation<Plate, Tip> {
        let r = Rotation::assert_frames(Bend(*bend).rotation().quat());
        let steady = self.torsion.as_ref().map_or(0.0, |t| t.twist(bend));
        let slow = self.twisting.as_mut().map_or(0.0, |t| t.step(bend, dt_s));
        if steady == 0.0 && slow == 0.0 {
            return r;
        }
        let twist = UnitQuaternion::from_scaled_axis(Vector3::z() * (steady + slow));
        r * Rotation::<Tip, Tip>::assert_frames(twist)
    }
}
