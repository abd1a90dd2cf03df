//! What a plant is: the nominal machine, the place it stands in, its sensors, its imperfections.
//!
//! `PlantConfig::default()` is the ideal plant: the transmission, lag and IMU noise of the nominal
//! model and nothing else. Angles are degrees, lengths mm, as in every file.

use crate::model::drive::Drive;
use crate::primitives::frames::{Rotation, World};
use crate::simulation::plant::check::{PlantError, range, ranges};
use crate::simulation::plant::effects::Effects;
use crate::simulation::plant::imu::chip::ImuConfig;
use crate::simulation::plant::shape::arc::Plate;
use crate::simulation::plant::spread::Spread;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// One plant, fully described. Everything has a default; see each table.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantConfig {
    /// Motor, rack and pinion.
    pub drive: DriveConfig,
    /// Pneumatic transmission.
    pub line: LineConfig,
    /// Bending section.
    pub shape: ShapeConfig,
    /// Where it stands in the world.
    pub base: BaseConfig,
    /// The magnetic field it stands in.
    pub field: FieldConfig,
    /// The IMU in the tip (and the one on the base, if there is one).
    pub imu: ImuConfig,
    /// Causes beyond the nominal model.
    pub effects: Effects,
    /// How units differ from this one.
    pub spread: Spread,
}

/// Motor, rack and pinion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DriveConfig {
    /// Piston travel per microstep, mm. Default 0.029452 (30 mm pinion, 200 full steps, 16
    /// microsteps). Bigger moves the piston further per step.
    pub step_mm: f64,
    /// Microsteps per full step of the motor. Default 16. Four full steps are one cycle of the coil
    /// currents, so bigger makes the motors' field turn more slowly with the piston.
    pub microsteps: f64,
}

impl Default for DriveConfig {
    fn default() -> Self {
        Self { step_mm: Drive::default().step_mm, microsteps: 16.0 }
    }
}

/// Pneumatic transmission: play, then `q = w / (1 + k_ε)` for small signals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LineConfig {
    /// Extension gain of each line for small signals, dimensionless: piston travel lost in the air
    /// per bellow travel. Default the paper's [2.22, 2.53, 2.21]. Bigger bends less.
    pub k_epsilon: [f64; 3],
    /// Half-width of each channel's play, mm of piston. Default the paper's [0.87, 0.92, 0.81].
    /// Bigger loses more at every reversal.
    pub k_lambda_mm: [f64; 3],
    /// Gauge pressure per mm of bellow elongation, kPa/mm. Default 3.2, which is 17 kPa at 75° of
    /// bend. Bigger makes every cause that follows pressure act more.
    pub kpa_per_mm: f64,
    /// First-order lag from line to motion, s. Default 0.025; the nominal model allows 0.01 to 0.05.
    /// Bigger is slower.
    pub lag_s: f64,
}

impl Default for LineConfig {
    fn default() -> Self {
        Self { k_epsilon: [2.22, 2.53, 2.21], k_lambda_mm: [0.87, 0.92, 0.81], kpa_per_mm: 3.2, lag_s: 0.025 }
    }
}

/// Bending section as it was really built.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShapeConfig {
    /// Distance of each bellow from the centre line, mm. Default 4.0415 (triangle of side 7 mm).
    /// Bigger bends less for the same stroke.
    pub r_mm: [f64; 3],
    /// How far each bellow sits from its place at 0, 120 and 240°, degrees. Default 0. Bigger turns
    /// and skews the bend; what a whole batch is off by belongs to `effects.clocking` instead.
    pub angle_deg: [f64; 3],
    /// Bellow length at atmospheric pressure, mm. Default 20. Bigger moves the tip further.
    pub rest_length_mm: f64,
}

impl Default for ShapeConfig {
    fn default() -> Self {
        Self { r_mm: [7.0 / 3f64.sqrt(); 3], angle_deg: [0.0; 3], rest_length_mm: 20.0 }
    }
}

/// How the base is held: `Rz(yaw) Ry(pitch) Rx(roll)` takes base to world.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BaseConfig {
    /// Heading of the base, degrees from magnetic north, left positive. Default 0. Only the
    /// magnetometer notices.
    pub yaw_deg: f64,
    /// Tilt from upright about the base's y axis, degrees. Default 0: the straight tip points up; 90
    /// holds it level, 180 hangs it down.
    pub pitch_deg: f64,
    /// Turn about the base's x axis before the tilt, degrees. Default 0.
    pub roll_deg: f64,
    /// Whether the base carries an IMU of its own, built like the tip's. Default false.
    pub imu: bool,
}

impl BaseConfig {
    /// Attitude of the proximal plate in the world.
    pub(crate) fn attitude(&self) -> Rotation<World, Plate> {
        let turn = |axis: Vector3<f64>, deg: f64| UnitQuaternion::from_scaled_axis(axis * deg.to_radians());
        Rotation::assert_frames(turn(Vector3::z(), self.yaw_deg) * turn(Vector3::y(), self.pitch_deg) * turn(Vector3::x(), self.roll_deg))
    }
}

/// The Earth's magnetic field, north along the world's x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FieldConfig {
    /// Strength, µT. Default 48. Bigger makes every disturbance of the magnetometer smaller in
    /// comparison.
    pub strength_ut: f64,
    /// Dip below the horizon, degrees. Default 65 (central Europe). Bigger leaves less of the field
    /// to tell the heading by.
    pub dip_deg: f64,
}

impl Default for FieldConfig {
    fn default() -> Self {
        Self { strength_ut: 48.0, dip_deg: 65.0 }
    }
}

impl FieldConfig {
    /// The field in the world frame, µT.
    #[must_use]
    pub fn vector_ut(&self) -> Vector3<f64> {
        let (sin, cos) = self.dip_deg.to_radians().sin_cos();
        Vector3::new(cos, 0.0, -sin) * self.strength_ut
    }
}

impl PlantConfig {
    /// Checks every parameter against what the physics can run with.
    ///
    /// # Errors
    /// [`PlantError::Range`] for the first that is outside.
    pub fn validate(&self) -> Result<(), PlantError> {
        range("drive.step_mm", self.drive.step_mm, 1e-4..=1.0, "0.0295 is the paper's rack and pinion")?;
        range("drive.microsteps", self.drive.microsteps, 1.0..=256.0, "16 is the paper's driver")?;
        let line = &self.line;
        ranges("line.k_epsilon", &line.k_epsilon, 0.0..=20.0, "the paper found 2.2 to 2.5")?;
        ranges("line.k_lambda_mm", &line.k_lambda_mm, 0.0..=5.0, "the paper found 0.8 to 0.9 mm")?;
        range("line.kpa_per_mm", line.kpa_per_mm, 0.01..=50.0, "a nitrile bellow is near 3")?;
        range("line.lag_s", line.lag_s, 0.0..=1.0, "a lag above 0.05 s belongs to effects.line_lag")?;
        let shape = &self.shape;
        ranges("shape.r_mm", &shape.r_mm, 1.0..=20.0, "side of the triangle / √3")?;
        ranges("shape.angle_deg", &shape.angle_deg, -40.0..=40.0, "a bellow cannot pass its neighbour")?;
        range("shape.rest_length_mm", shape.rest_length_mm, 5.0..=100.0, "the paper's bellow is 14 to 29 mm")?;
        for (name, deg) in [("yaw", self.base.yaw_deg), ("pitch", self.base.pitch_deg), ("roll", self.base.roll_deg)] {
            range(&format!("base.{name}_deg"), deg, -360.0..=360.0, "one turn is enough")?;
        }
        range("field.strength_ut", self.field.strength_ut, 0.0..=1000.0, "the Earth's is 25 to 65 µT")?;
        range("field.dip_deg", self.field.dip_deg, -90.0..=90.0, "straight down is 90")?;
        self.imu.validate()?;
        self.effects.validate()?;
        self.spread.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_survives_toml() {
        let config = PlantConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<PlantConfig>(&text).unwrap(), config);
        assert_eq!(toml::from_str::<PlantConfig>("").unwrap(), config);
    }

    #[test]
    fn unknown_and_impossible_are_refused() {
        let why = toml::from_str::<PlantConfig>("[line]\nk_epsilom = [1, 1, 1]").unwrap_err();
        assert!(why.to_string().contains("k_epsilom"), "{why}");
        let config = toml::from_str::<PlantConfig>("[line]\nk_epsilon = [1.0, nan, 1.0]").unwrap();
        assert!(config.validate().unwrap_err().to_string().contains("plant.line.k_epsilon[2] = NaN"));
    }

    #[test]
    fn pitch_lays_the_tip_level() {
        let base = BaseConfig { pitch_deg: 90.0, ..BaseConfig::default() };
        let axis = base.attitude().apply(&Vector3::z());
        assert!((axis - Vector3::x()).norm() < 1e-12);
    }
}
