//! From bellow lengths to the orientation of the tip on its base plate.
//!
//! `q → bend and length of the section as built → bend under load → wall → orientation with twist`. Nominally
//! this is constant curvature.

pub(crate) mod arc;

use crate::model::Bend;
use crate::primitives::{Rotation, Tip, World};
use crate::simulation::plant::config::ShapeConfig;
use crate::simulation::plant::effects::contact::Touching;
use crate::simulation::plant::law::{Law, Laws, Moment, SectionState, Step, each};
use arc::{Plate, Section, Terms};
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// The bending section with its state.
#[derive(Debug)]
pub(crate) struct Shape {
    section: Section,
    /// Injected fault: a wall in place of that of the configuration.
    pub(crate) wall: Option<Touching>,
}

/// The tip on the plate.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pose {
    /// Orientation, tip to plate.
    pub(crate) r_plate_tip: Rotation<Plate, Tip>,
    bend: Vector2<f64>,
    length_mm: f64,
    /// True while a wall holds the tip.
    pub(crate) touched: bool,
}

impl Pose {
    /// Position of the tip on the plate, mm.
    pub(crate) fn tip_mm(&self) -> Vector3<f64> {
        Terms::of(&self.bend).tip_mm(&self.bend, self.length_mm)
    }
}

impl Shape {
    pub(crate) fn new(config: &ShapeConfig) -> Self {
        let offset = config.angle_deg.map(f64::to_radians);
        Self {
            section: Section::new(config.r_mm, &offset, config.rest_length_mm),
            wall: None,
        }
    }

    /// The pose after one step with bellow length changes `bellow_mm` and the plate held as given.
    pub(crate) fn step(
        &mut self,
        bellow_mm: &Vector3<f64>,
        r_world_plate: Rotation<World, Plate>,
        now: &mut Step<'_>,
    ) -> Pose {
        let Step { at, laws, faults } = now;
        let (mut bend, length_mm) = match laws.iter().find_map(|law| law.offsets(bellow_mm)) {
            Some(offsets) => self.section.turned(&offsets).shape(bellow_mm),
            None => self.section.shape(bellow_mm),
        };
        let section = SectionState {
            t: at.t,
            length_mm,
            longer_mm: length_mm - self.section.rest_length_mm,
            r_world_plate,
        };
        each(laws, |law| law.bend(&mut bend, &section));
        bend += faults.push.0;
        let touched = match &mut self.wall {
            Some(wall) => wall.contact(&mut bend, at),
            None => {
                let mut touched = false;
                each(laws, |law| touched |= law.contact(&mut bend, at));
                touched
            }
        };
        Pose {
            r_plate_tip: oriented(&bend, at, laws),
            bend,
            length_mm,
            touched,
        }
    }
}

fn oriented(bend: &Vector2<f64>, at: &Moment, laws: &mut Laws) -> Rotation<Plate, Tip> {
    let r = Rotation::assert_frames(Bend(*bend).rotation().quat());
    let twist: f64 = laws.iter_mut().map(|law| law.twist(bend, at)).sum();
    if twist == 0.0 {
        return r;
    }
    r * Rotation::<Tip, Tip>::assert_frames(UnitQuaternion::from_scaled_axis(Vector3::z() * twist))
}
