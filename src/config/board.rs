//! Board files: what the machine is.

use crate::config::hardware::{HomingSection, ImuSection, MachineSection, check_hardware};
use crate::config::power::PowerSection;
use crate::config::service::{SafetySection, ServiceSection};
use crate::control::follow::Pace;
use crate::control::limits::ActuatorLimits;
use crate::hardware::pins::PinsConfig;
use crate::model::arc::Geometry;
use crate::model::drive::Drive;
use crate::motion::{MotionConfig, StepperConfig};
use crate::primitives::check::{Check, Checker};
use crate::simulation::plant::config::{BaseConfig, DriveConfig, FieldConfig, LineConfig, ShapeConfig};
use crate::simulation::plant::effects::Effects;
use crate::simulation::plant::imu::chip::ImuConfig;
use crate::simulation::plant::spread::Spread;
use crate::simulation::plant::{PlantConfig, PlantError};
use serde::Deserialize;

/// A board file.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Board {
    /// The computer and the loop that runs on it.
    pub machine: MachineSection,
    /// The bending section.
    pub geometry: GeometrySection,
    /// Motor, rack and pinion.
    pub drive: DriveSection,
    /// How fast a piston may go.
    pub motion: MotionSection,
    /// How far it may go.
    pub limits: LimitsSection,
    /// What pressure does to a motor without current.
    pub power: PowerSection,
    /// How zero is found.
    pub homing: HomingSection,
    /// Pulses and the thread that makes them.
    pub stepper: StepperConfig,
    /// The wiring, on boards that have any.
    pub pins: Option<PinsConfig>,
    /// The tip's IMU, on boards that have one.
    pub imu: Option<ImuSection>,
    /// An IMU on the base, where there is one.
    pub base_imu: Option<ImuSection>,
    /// The gate between controller and step generator.
    pub safety: SafetySection,
    /// The daemon.
    pub service: ServiceSection,
    /// The built-in plant, on boards that have one.
    pub plant: Option<PlantSection>,
}

/// The bending section.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GeometrySection {
    /// Side T of the triangle whose corners are the bellows, mm. Default 7. Larger: more bellow
    /// stroke per degree of bend.
    pub triangle_side_mm: f64,
    /// Bellow length at atmospheric pressure l₀, mm. Default 20.
    pub rest_length_mm: f64,
    /// Shortest bellow, mm. Default 14. Larger forbids tighter bends.
    pub bellow_min_mm: f64,
    /// Longest bellow, mm. Default 29. Smaller forbids tighter bends.
    pub bellow_max_mm: f64,
}

impl Default for GeometrySection {
    fn default() -> Self {
        Self { triangle_side_mm: 7.0, rest_length_mm: 20.0, bellow_min_mm: 14.0, bellow_max_mm: 29.0 }
    }
}

impl GeometrySection {
    /// The kinematic law of this section.
    #[must_use]
    pub fn law(&self) -> Geometry {
        Geometry { r_mm: self.triangle_side_mm / 3f64.sqrt(), rest_length_mm: self.rest_length_mm }
    }
}

/// Motor, rack and pinion.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DriveSection {
    /// Pitch diameter of the pinion, mm. Default 30. Larger moves the piston further per step.
    pub pinion_pitch_diameter_mm: f64,
    /// Full steps of the motor per turn. Default 200.
    pub full_steps: u32,
    /// Microsteps per full step as the driver is strapped. Default 16.
    pub microsteps: u32,
}

impl Default for DriveSection {
    fn default() -> Self {
        Self { pinion_pitch_diameter_mm: 30.0, full_steps: 200, microsteps: 16 }
    }
}

impl DriveSection {
    /// The drive law of this section.
    #[must_use]
    pub fn law(&self) -> Drive {
        Drive::rack_and_pinion(self.pinion_pitch_diameter_mm, self.full_steps, self.microsteps)
    }
}

/// How fast a piston may go.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionSection {
    /// Largest piston speed, mm/s. Default 30 (about 1,000 microsteps a second). Larger settles
    /// sooner until the motor loses steps.
    pub speed_max_mm_s: f64,
    /// Largest piston acceleration, mm/s². Default 600. Larger crosses the backlash sooner until the
    /// motor loses steps.
    pub acceleration_max_mm_s2: f64,
    /// Largest change of the acceleration, mm/s³. Default 30,000: full acceleration after 20 ms. Larger
    /// answers quicker; smaller shakes rack, tube and tip less.
    pub jerk_max_mm_s3: f64,
    /// A target nearer than this to the one being driven to counts as the same, mm. Default 0: every
    /// change is followed. Larger plans less often and rests that much beside what was asked for.
    pub retarget_min_mm: f64,
}

impl Default for MotionSection {
    fn default() -> Self {
        Self { speed_max_mm_s: 30.0, acceleration_max_mm_s2: 600.0, jerk_max_mm_s3: 30_000.0, retarget_min_mm: 0.0 }
    }
}

impl MotionSection {
    /// The pace of one piston.
    #[must_use]
    pub fn pace(&self) -> Pace {
        Pace { speed: self.speed_max_mm_s, acceleration: self.acceleration_max_mm_s2 }
    }
}

/// How far a piston may go.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsSection {
    /// Piston travel either way from rest, mm. Default 30 (half the rack). Larger than the rack runs
    /// the pinion off it.
    pub travel_mm: f64,
    /// Gauge pressure per mm of piston that compresses air, kPa/mm. Default 1.4: 17.5 kPa at the
    /// paper's largest bend. Larger stops the piston sooner.
    pub pressure_kpa_per_mm: f64,
    /// Largest gauge pressure of either sign, kPa. Default 41.3 (the paper's 6 PSI). Larger risks the
    /// bellow.
    pub pressure_max_kpa: f64,
}

impl Default for LimitsSection {
    fn default() -> Self {
        Self { travel_mm: 30.0, pressure_kpa_per_mm: 1.4, pressure_max_kpa: 41.3 }
    }
}

/// The built-in plant: how finely it is simulated, then the plant's own tables.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantSection {
    /// Time of one tick, s. Default 0.001: the loop and the truth go on by a millisecond at a time,
    /// the IMU answers at its own `imu.period_s`. Larger simulates faster and coarser.
    pub period_s: f64,
    /// Motor, rack and pinion.
    pub drive: DriveConfig,
    /// Pneumatic transmission.
    pub line: LineConfig,
    /// Bending section as it was really built.
    pub shape: ShapeConfig,
    /// Where it stands in the world.
    pub base: BaseConfig,
    /// The magnetic field it stands in.
    pub field: FieldConfig,
    /// The IMU.
    pub imu: ImuConfig,
    /// Causes beyond the nominal model.
    pub effects: Effects,
    /// How units differ.
    pub spread: Spread,
}

impl Default for PlantSection {
    fn default() -> Self {
        let PlantConfig { drive, line, shape, base, field, imu, effects, spread } = PlantConfig::default();
        Self { period_s: 0.001, drive, line, shape, base, field, imu, effects, spread }
    }
}

impl PlantSection {
    /// The plant that this section describes.
    #[must_use]
    pub fn make(&self) -> PlantConfig {
        let Self { period_s: _, drive, line, shape, base, field, imu, effects, spread } = self.clone();
        PlantConfig { drive, line, shape, base, field, imu, effects, spread }
    }
}

impl Board {
    /// Motion of one piston within this board's limits.
    #[must_use]
    pub fn motion_config(&self) -> MotionConfig {
        MotionConfig {
            speed_max_mm_s: self.motion.speed_max_mm_s,
            acceleration_max_mm_s2: self.motion.acceleration_max_mm_s2,
            jerk_max_mm_s3: self.motion.jerk_max_mm_s3,
            travel_max_mm: self.limits.travel_mm,
            retarget_min_mm: self.motion.retarget_min_mm,
        }
    }

    /// The static limits of this board.
    #[must_use]
    pub fn limits(&self) -> ActuatorLimits {
        ActuatorLimits {
            travel_mm: self.limits.travel_mm,
            pressure_kpa_per_mm: self.limits.pressure_kpa_per_mm,
            pressure_max_kpa: self.limits.pressure_max_kpa,
            bellow_min_mm: self.geometry.bellow_min_mm,
            bellow_max_mm: self.geometry.bellow_max_mm,
        }
    }
}

impl Check for Board {
    fn check(&self, to: &mut Checker) {
        let g = &self.geometry;
        to.range("geometry.triangle_side_mm", g.triangle_side_mm, 2.0..=30.0, "mm", "measure between two bellow axes");
        to.range("geometry.rest_length_mm", g.rest_length_mm, 5.0..=100.0, "mm", "measure a bellow at atmospheric pressure");
        to.range(
            "geometry.bellow_min_mm",
            g.bellow_min_mm,
            1.0..=g.rest_length_mm,
            "mm",
            "the shortest bellow is shorter than the resting one",
        );
        to.range(
            "geometry.bellow_max_mm",
            g.bellow_max_mm,
            g.rest_length_mm..=200.0,
            "mm",
            "the longest bellow is longer than the resting one",
        );
        let d = &self.drive;
        to.range("drive.pinion_pitch_diameter_mm", d.pinion_pitch_diameter_mm, 2.0..=100.0, "mm", "module times number of teeth");
        to.range("drive.full_steps", f64::from(d.full_steps), 20.0..=800.0, "", "200 for a 1.8° motor");
        let powers = [1, 2, 4, 8, 16, 32];
        to.holds(
            "drive.microsteps",
            powers.contains(&d.microsteps),
            &format!("{} is not a microstep divider", d.microsteps),
            "use 1, 2, 4, 8, 16 or 32, as the driver is strapped",
        );
        let m = &self.motion;
        to.range(
            "motion.speed_max_mm_s",
            m.speed_max_mm_s,
            0.1..=200.0,
            "mm/s",
            "30 is the paper's motor at about 1,000 microsteps a second",
        );
        to.range("motion.acceleration_max_mm_s2", m.acceleration_max_mm_s2, 1.0..=20_000.0, "mm/s²", "600 is gentle on a small stepper");
        to.range("motion.jerk_max_mm_s3", m.jerk_max_mm_s3, 100.0..=1e7, "mm/s³", "fifty times the acceleration reaches it within 20 ms");
        to.range("motion.retarget_min_mm", m.retarget_min_mm, 0.0..=1.0, "mm", "leave it out to follow every change");
        let l = &self.limits;
        to.range("limits.travel_mm", l.travel_mm, 1.0..=100.0, "mm", "half the rack's length");
        to.range(
            "limits.pressure_kpa_per_mm",
            l.pressure_kpa_per_mm,
            0.01..=100.0,
            "kPa/mm",
            "read a gauge while the piston moves by 1 mm against a blocked bellow",
        );
        to.range("limits.pressure_max_kpa", l.pressure_max_kpa, 1.0..=200.0, "kPa", "the paper stays under 6 PSI = 41.4 kPa");

        check_hardware(self, to);
        self.safety.check(to);
        self.service.check(to);
        if let Some(plant) = &self.plant {
            to.range("plant.period_s", plant.period_s, 1e-4..=0.01, "s", "0.001 is a loop at 1 kHz");
            check_plant(to, plant.make().validate());
        }
    }
}

/// What the built-in plant says of its parameters; it counts channels from 1, files from 0.
fn check_plant(to: &mut Checker, verdict: Result<(), PlantError>) {
    match verdict {
        Ok(()) => {}
        Err(PlantError::Range { name, value, low, high, mend }) => {
            let key = match name.strip_suffix(']').and_then(|n| n.split_once('[')) {
                Some((array, index)) => format!("plant.{array}.{}", index.parse::<usize>().map_or(0, |i| i.saturating_sub(1))),
                None => format!("plant.{name}"),
            };
            to.refuse(&key, format!("{value} is outside {low} to {high}"), mend);
        }
        Err(other) => to.refuse("plant", other.to_string(), "see the tables of boards/sim.toml"),
    }
}
