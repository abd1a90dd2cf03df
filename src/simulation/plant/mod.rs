//! The built-in plant: a truth that the controller does not share.
//!
//! One step is one page, [`Plant::step`]: microstep counts go through drive, line, bellows and shape
//! to the true orientation of the tip, and the IMU says of it what a chip would. Each stage is a room
//! of its own; each cause beyond the nominal model is one file of its stage, with its law, its
//! parameters and its test. Forms are the plant's own and deliberately not those that the diagnosis
//! fits: what it finds, it must find by signature.
//!
//! The plant holds its own seeded random numbers and its own time; equal configuration, seed and
//! counts give equal output to the last bit. A step allocates nothing.

pub mod base;
pub mod bellows;
mod check;
mod choice;
pub mod config;
pub mod drive;
pub mod effects;
mod fault;
pub mod imu;
pub mod line;
mod memory;
mod plant_effect;
mod rng;
pub mod shape;
pub mod spread;
pub mod timing;
mod unit;

pub use check::PlantError;
pub use config::PlantConfig;
pub use effects::{EffectName, effect_names};
pub use fault::{Channel, InjectedFault};

use crate::primitives::frames::{Base, Rotation, Tip};
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Seconds, Steps};
use crate::simulation::plant::base::Stand;
use crate::simulation::plant::bellows::Bellows;
use crate::simulation::plant::drive::Drive;
use crate::simulation::plant::imu::motor_field::Motors;
use crate::simulation::plant::imu::{Imu, Surroundings};
use crate::simulation::plant::line::Line;
use crate::simulation::plant::plant_effect::active;
use crate::simulation::plant::shape::arc::Plate;
use crate::simulation::plant::shape::{Pose, Shape};
use crate::simulation::plant::timing::DeadTime;
use nalgebra::Vector3;

/// A running plant.
#[derive(Debug, Clone)]
pub struct Plant {
    config: PlantConfig,
    t: f64,
    commands: Option<DeadTime<Vector3<f64>>>,
    drive: Drive,
    line: Line,
    bellows: Bellows,
    shape: Shape,
    stand: Stand,
    r_base_plate: Rotation<Base, Plate>,
    field_ut: Vector3<f64>,
    motors: Option<Motors>,
    motors_t: f64,
    magnet_ut: Vector3<f64>,
    imu: Imu,
    base_imu: Option<Imu>,
}

/// What one step gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Time reached, s since the start.
    pub t: Seconds,
    /// The tip's IMU, `None` between samples.
    pub imu: Option<ImuSample>,
    /// The base's IMU, if there is one, in the base frame.
    pub base_imu: Option<ImuSample>,
    /// What really happened; for judges, never for controllers.
    pub truth: Truth,
}

/// What really happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Tip orientation relative to rest.
    pub r_base_tip: Rotation<Base, Tip>,
    /// Length changes of the bellows, mm.
    pub bellow_mm: Vector3<f64>,
    /// Far ends of the plays, mm of piston.
    pub play_output_mm: Vector3<f64>,
    /// Gauge pressures, kPa.
    pub pressure_kpa: Vector3<f64>,
    /// A wall holds the tip.
    pub wall_touched: bool,
}

impl Plant {
    /// A plant at rest: pistons at zero, play centred, tip still.
    ///
    /// # Errors
    /// [`PlantError::Range`] for a parameter that the physics cannot run with.
    pub fn new(config: &PlantConfig, seed: u64) -> Result<Self, PlantError> {
        config.validate()?;
        let effects = &config.effects;
        let stand = Stand::new(config.base.attitude(), active(effects.base_motion.as_ref()));
        let mut shape = Shape::new(config);
        let rest = shape.step(&Vector3::zeros(), &stand.attitude(0.0), 0.0);
        let r_plate_base = Rotation::<Plate, Base>::assert_frames(rest.r_plate_tip.quat());
        let mut motors = active(effects.motor_field.as_ref()).map(|c| Motors::new(c, config.drive.microsteps));
        let motors_ut = motors.as_mut().map_or_else(Vector3::zeros, |m| m.field_ut(&Vector3::zeros(), 0.0));
        let field_ut = config.field.vector_ut();
        let here = surroundings(&stand, &rest, 0.0, field_ut + motors_ut);
        Ok(Self {
            t: 0.0,
            commands: active(effects.transport_delay.as_ref()).map(|c| DeadTime::transport(&c, Vector3::zeros(), seed)),
            drive: Drive::new(config),
            line: Line::new(config),
            bellows: Bellows::new(config),
            shape,
            stand,
            r_base_plate: r_plate_base.inverse(),
            field_ut,
            motors,
            motors_t: 0.0,
            magnet_ut: Vector3::zeros(),
            imu: Imu::tip(config, seed, here),
            base_imu: config.base.imu.then(|| Imu::base(config, seed, Surroundings { at_mm: Vector3::zeros(), ..here })),
            config: config.clone(),
        })
    }

    /// What it was built from.
    #[must_use]
    pub fn config(&self) -> &PlantConfig {
        &self.config
    }

    /// Holds the counts for `dt_s` (> 0) from now on and lets the truth go on by `dt_s`.
    pub fn step(&mut self, steps: &Steps, dt_s: f64) -> Output {
        self.t += dt_s;
        let t = self.t;
        let sent = Vector3::from(steps.0.map(f64::from));
        let counts = self.commands.as_mut().map_or(sent, |c| c.pass(t, dt_s, sent));
        let plunger_mm = self.drive.step(&counts, t, dt_s);
        let air_mm = self.line.step(&plunger_mm, &self.bellows.estimate, dt_s);
        let bellow_mm = self.bellows.step(&air_mm, t, dt_s);
        let pose = self.shape.step(&bellow_mm, &self.stand.attitude(t), dt_s);
        let (imu, base_imu) = self.sense(&pose, &counts);
        let truth = Truth {
            r_base_tip: self.r_base_plate * pose.r_plate_tip,
            bellow_mm,
            play_output_mm: self.line.play_output_mm(),
            pressure_kpa: self.bellows.estimate.pressure_kpa,
            wall_touched: pose.touched,
        };
        Output { t: Seconds(t), imu, base_imu, truth }
    }

    /// Samples that are due, with the drivers at `counts`.
    fn sense(&mut self, pose: &Pose, counts: &Vector3<f64>) -> (Option<ImuSample>, Option<ImuSample>) {
        if !self.imu.due(self.t) {
            return (None, None);
        }
        let motors_ut = match &mut self.motors {
            Some(motors) => motors.field_ut(counts, self.t - self.motors_t),
            None => Vector3::zeros(),
        };
        self.motors_t = self.t;
        let here = surroundings(&self.stand, pose, self.t, self.field_ut + self.magnet_ut + motors_ut);
        let base_imu = self.base_imu.as_mut().and_then(|imu| {
            let r_world_base = self.stand.attitude(self.t) * self.r_base_plate.inverse();
            // a chip that stands in the base frame: for it, that is its tip
            let r_world_tip = Rotation::assert_frames(r_world_base.quat());
            imu.sample(&Surroundings { r_world_tip, at_mm: Vector3::zeros(), ..here })
        });
        (self.imu.sample(&here), base_imu)
    }
}

/// What surrounds the tip in a pose.
fn surroundings(stand: &Stand, pose: &Pose, t: f64, field_ut: Vector3<f64>) -> Surroundings {
    let r_world_plate = stand.attitude(t);
    Surroundings { t, r_world_tip: r_world_plate * pose.r_plate_tip, at_mm: r_world_plate.apply(&pose.tip_mm()), field_ut }
}
