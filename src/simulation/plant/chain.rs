//! The running plant: one step from counts to orientation and samples.

use crate::primitives::{Base, ImuSample, Rotation, Seconds, Steps, Tip, World};
use crate::simulation::plant::bellows::Bellows;
use crate::simulation::plant::config::PlantConfig;
use crate::simulation::plant::drive::Drive;
use crate::simulation::plant::effects::contact::{Contact, Touching};
use crate::simulation::plant::fault::Faults;
use crate::simulation::plant::imu::{Imu, Surroundings};
use crate::simulation::plant::law::{Laws, Moment, Step, each};
use crate::simulation::plant::line::Line;
use crate::simulation::plant::parameters::PlantError;
use crate::simulation::plant::shape::arc::Plate;
use crate::simulation::plant::shape::{Pose, Shape};
use crate::simulation::plant::stand::Stand;
use nalgebra::Vector3;

/// Give of an injected wall, degrees of bend: soft tissue.
const WALL_GIVE_DEG: f64 = 4.0;

/// A running plant.
#[derive(Debug)]
pub struct Plant {
    /// The configuration that it was built from.
    pub config: PlantConfig,
    t: f64,
    laws: Laws,
    drive: Drive,
    line: Line,
    bellows: Bellows,
    shape: Shape,
    stand: Stand,
    r_base_plate: Rotation<Base, Plate>,
    field_ut: Vector3<f64>,
    sensed_t: f64,
    imu: Imu,
    base_imu: Option<Imu>,
    /// The faults that are injected.
    pub faults: Faults,
}

/// Result of one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Time reached, s since the start.
    pub t: Seconds,
    /// Sample of the tip's IMU, `None` between samples.
    pub imu: Option<ImuSample>,
    /// Sample of the base's IMU, if there is one, in the base frame.
    pub base_imu: Option<ImuSample>,
    /// True state, for scoring only.
    pub truth: Truth,
}

/// True state of a plant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Tip orientation relative to the start.
    pub r_base_tip: Rotation<Base, Tip>,
    /// Attitude of the base in the world.
    pub r_world_base: Rotation<World, Base>,
    /// Length changes of the bellows, mm.
    pub bellow_mm: Vector3<f64>,
    /// Outputs of the play operators, mm of piston.
    pub play_output_mm: Vector3<f64>,
    /// Gauge pressures, kPa.
    pub pressure_kpa: Vector3<f64>,
    /// True while a wall holds the tip.
    pub wall_touched: bool,
}

impl Plant {
    /// A plant at rest: pistons at zero, play centred, tip still.
    ///
    /// # Errors
    /// [`PlantError::Range`] for a parameter that the physics does not support.
    pub fn new(config: &PlantConfig, seed: u64) -> Result<Self, PlantError> {
        config.validate()?;
        let unit = config.unit_data(seed);
        let mut laws = config.effects.laws(&unit);
        let stand = Stand::new(config.base.attitude());
        let r_world_plate = stand.attitude(0.0, &laws);
        let mut shape = Shape::new(&config.shape);
        let mut start = Step {
            at: Moment { t: 0.0, dt_s: 0.0 },
            laws: &mut laws,
            faults: &Faults::default(),
        };
        let rest = shape.step(&Vector3::zeros(), r_world_plate, &mut start);
        let r_plate_base = Rotation::<Plate, Base>::assert_frames(rest.r_plate_tip.quat());
        let field_ut = config.field.vector_ut();
        let mut here = surroundings(r_world_plate, &rest, 0.0, field_ut);
        each(&mut laws, |law| {
            law.field(&mut here.field_ut, &Vector3::zeros(), 0.0)
        });
        let at_base = Surroundings {
            at_mm: Vector3::zeros(),
            ..here
        };
        let of_base = || Imu::base(&config.base_imu(), seed, at_base);
        let base_imu = config.base.imu.then(of_base);
        Ok(Self {
            t: 0.0,
            drive: Drive::new(&unit),
            line: Line::new(&config.line),
            bellows: Bellows::new(&config.line, &laws),
            shape,
            stand,
            r_base_plate: r_plate_base.inverse(),
            field_ut,
            sensed_t: 0.0,
            imu: Imu::tip(&config.imu, seed, here, &mut laws),
            base_imu,
            laws,
            faults: Faults::default(),
            config: config.clone(),
        })
    }

    /// Holds the counts for `dt_s` (> 0) from now on and advances the plant by `dt_s`.
    pub fn step(&mut self, steps: &Steps, dt_s: f64) -> Output {
        self.t += dt_s;
        let at = Moment { t: self.t, dt_s };
        let (laws, faults) = (&mut self.laws, &self.faults);
        let now = &mut Step { at, laws, faults };
        let mut counts = Vector3::from(steps.0.map(f64::from));
        each(now.laws, |law| law.command(&mut counts, &at));
        let plunger_mm = self.drive.step(&counts, now);
        let air_mm = self.line.step(&plunger_mm, &self.bellows.state, now);
        let bellow_mm = self.bellows.step(&air_mm, now);
        let r_world_plate = self.stand.attitude(at.t, now.laws);
        let pose = self.shape.step(&bellow_mm, r_world_plate, now);
        let field_ut = self.field_ut + faults.magnet_ut;
        let here = surroundings(r_world_plate, &pose, at.t, field_ut);
        let (imu, base_imu) = self.sense(here, &counts);
        let truth = Truth {
            r_base_tip: self.r_base_plate * pose.r_plate_tip,
            r_world_base: r_world_plate * self.r_base_plate.inverse(),
            bellow_mm,
            play_output_mm: self.line.play_output_mm,
            pressure_kpa: self.bellows.state.pressure_kpa,
            wall_touched: pose.touched,
        };
        Output {
            t: Seconds(at.t),
            imu,
            base_imu,
            truth,
        }
    }

    /// Lets the rotor of a channel fall behind by microsteps that nothing counts; below 0 it runs ahead.
    pub fn slip(&mut self, channel: usize, microsteps: i32) {
        self.drive.rotor[channel] -= f64::from(microsteps);
    }

    /// Turns the base about an axis in the world of any length but 0, within a time; 0 is instantaneous.
    pub fn turn_base(&mut self, axis: [f64; 3], angle_deg: f64, over_s: f64) {
        let axis = Vector3::from(axis).try_normalize(1e-9).unwrap_or_default();
        self.stand
            .begin_turn(axis * angle_deg.to_radians(), self.t, over_s);
    }

    /// Puts a soft wall in the way of the tip, at a bend in a direction, degrees.
    pub fn put_wall(&mut self, at_deg: f64, direction_deg: f64) {
        self.shape.wall = Some(Touching::new(Contact {
            block: 1.0,
            direction_deg,
            at_deg,
            give_deg: WALL_GIVE_DEG,
            ..Contact::default()
        }));
    }

    /// Opens the lines, pistons at zero, and closes them again: the air that leaked flows back.
    pub fn vent(&mut self) {
        self.line.vent(&mut self.laws);
    }

    /// Ends everything that was injected; consequences stay.
    pub fn clear(&mut self) {
        self.faults = Faults::default();
        self.stand.settle(self.t);
        self.shape.wall = None;
        each(&mut self.laws, |law| law.release());
    }

    /// Samples that are due, with the drivers at `counts`.
    fn sense(
        &mut self,
        mut here: Surroundings,
        counts: &Vector3<f64>,
    ) -> (Option<ImuSample>, Option<ImuSample>) {
        if !self.imu.due(self.t) {
            return (None, None);
        }
        let since_s = self.t - self.sensed_t;
        self.sensed_t = self.t;
        each(&mut self.laws, |law| {
            law.field(&mut here.field_ut, counts, since_s)
        });
        let base_imu = self.base_imu.as_mut().and_then(|imu| {
            let r_world_base =
                self.stand.attitude(self.t, &self.laws) * self.r_base_plate.inverse();
            // this chip stands in the base frame, which takes the place of its tip frame
            let r_world_tip = Rotation::assert_frames(r_world_base.quat());
            let sample = imu.sample(
                &Surroundings {
                    r_world_tip,
                    at_mm: Vector3::zeros(),
                    ..here
                },
                &mut Vec::new(),
                &mut self.faults.base_imu,
            );
            self.faults.base_imu.passes().then_some(sample)
        });
        let imu = self.imu.sample(&here, &mut self.laws, &mut self.faults.imu);
        (Some(imu), base_imu)
    }
}

/// The surroundings of the tip in a pose, in the field `field_ut`.
fn surroundings(
    r_world_plate: Rotation<World, Plate>,
    pose: &Pose,
    t: f64,
    field_ut: Vector3<f64>,
) -> Surroundings {
    Surroundings {
        t,
        r_world_tip: r_world_plate * pose.r_plate_tip,
        at_mm: r_world_plate.apply(&pose.tip_mm()),
        field_ut,
    }
}
