//! The configuration of a plant: the nominal machine, its surroundings, its sensors and its effects.
//!
//! `PlantConfig::default()` is the ideal plant: the transmission, lag and IMU noise of the nominal
//! model and nothing else. Angles are degrees, lengths mm, as in every file.

use crate::model::Drive;
use crate::primitives::{Invalid, Rotation, Setting, Shape, World};
use crate::simulation::plant::effects::{Effects, effect_names};
use crate::simulation::plant::imu::chip::ImuConfig;
use crate::simulation::plant::law::UnitData;
use crate::simulation::plant::parameters::{PlantError, Table, parameters};
use crate::simulation::plant::rng::{PlantRng, Stream};
use crate::simulation::plant::shape::arc::Plate;
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng;
use serde::{Deserialize, Serialize};

/// One plant, fully described. Everything has a default; see each table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantConfig {
    /// Time of one tick, s. Default 0.001: the loop and the truth go on by a millisecond at a time,
    /// the IMU answers at its own `imu.period_s`. Larger simulates faster and coarser.
    pub period_s: f64,
    /// Motor, rack and pinion.
    pub drive: DriveConfig,
    /// Pneumatic transmission.
    pub line: LineConfig,
    /// Bending section.
    pub shape: ShapeConfig,
    /// Attitude in the world.
    pub base: BaseConfig,
    /// The Earth's magnetic field.
    pub field: FieldConfig,
    /// The IMU in the tip, and the one on the base if there is one.
    pub imu: ImuConfig,
    /// Effects beyond the nominal model.
    pub effects: Effects,
    /// How units of this make differ.
    pub spread: Spread,
}

impl Default for PlantConfig {
    fn default() -> Self {
        Self {
            period_s: 0.001,
            drive: DriveConfig::default(),
            line: LineConfig::default(),
            shape: ShapeConfig::default(),
            base: BaseConfig::default(),
            field: FieldConfig::default(),
            imu: ImuConfig::default(),
            effects: Effects::default(),
            spread: Spread::default(),
        }
    }
}

/// The plant describes its own tables.
impl Setting for PlantConfig {
    const SHAPE: Shape = Shape::Opaque;
}

parameters! {
    /// Motor, rack and pinion.
    DriveConfig at "drive" {
        /// Piston travel per microstep, mm. Default 0.029452 (30 mm pinion, 200 full steps, 16
        /// microsteps). A larger value moves the piston further per step.
        step_mm: f64 = Drive::default().step_mm, "", 1e-4..=1.0, "0.0295 is the paper's rack and pinion";
        /// Microsteps per full step of the motor. Default 16. Four full steps are one cycle of the coil
        /// currents, so a larger value makes the motors' field turn more slowly with the piston.
        microsteps: f64 = 16.0, "", 1.0..=256.0, "16 is the paper's driver";
    }
}

parameters! {
    /// Pneumatic transmission: play, then `q = w / (1 + k_ε)` for small signals.
    LineConfig at "line" {
        /// Extension gain of each line for small signals, dimensionless: piston travel lost in the air
        /// per bellow travel. Default the paper's [2.22, 2.53, 2.21]. A larger value bends less.
        k_epsilon: [f64; 3] = [2.22, 2.53, 2.21], "", 0.0..=20.0, "the paper found 2.2 to 2.5";
        /// Half-width of each channel's play, mm of piston. Default the paper's [0.87, 0.92, 0.81].
        /// A larger value loses more at every reversal.
        k_lambda_mm: [f64; 3] = [0.87, 0.92, 0.81], "", 0.0..=5.0, "the paper found 0.8 to 0.9 mm";
        /// Gauge pressure per mm of bellow elongation, kPa/mm. Default 3.2, which is 17 kPa at 75° of
        /// bend. A larger value makes every effect that depends on pressure act more.
        kpa_per_mm: f64 = 3.2, "", 0.01..=50.0, "a nitrile bellow is near 3";
        /// First-order lag from line to motion, s. Default 0.025; the nominal model allows 0.01 to 0.05.
        /// A larger value is slower.
        lag_s: f64 = 0.025, "", 0.0..=1.0, "a lag above 0.05 s belongs to effects.line_lag";
    }
}

parameters! {
    /// Bending section as built.
    ShapeConfig at "shape" {
        /// Distance of each bellow from the centre line, mm. Default 4.0415 (triangle of side 7 mm).
        /// A larger value gives less bend for the same stroke.
        r_mm: [f64; 3] = [7.0 / 3f64.sqrt(); 3], "", 1.0..=20.0, "side of the triangle / √3";
        /// How far each bellow sits from its place at 0, 120 and 240°, degrees. Default 0. A larger value turns
        /// and skews the bend; what a whole batch is off by belongs to `effects.clocking` instead.
        angle_deg: [f64; 3] = [0.0; 3], "", -40.0..=40.0, "a bellow cannot pass its neighbour";
        /// Bellow length at atmospheric pressure, mm. Default 20. A larger value moves the tip further.
        rest_length_mm: f64 = 20.0, "", 5.0..=100.0, "the paper's bellow is 14 to 29 mm";
    }
}

parameters! {
    /// Attitude of the base: `Rz(yaw) Ry(pitch) Rx(roll)` takes base to world.
    BaseConfig at "base" {
        /// Heading of the base, degrees from magnetic north, left positive. Default 0. Only the
        /// magnetometer depends on it.
        yaw_deg: f64 = 0.0, "", -360.0..=360.0, "one turn is enough";
        /// Tilt from upright about the base's y axis, degrees. Default 0: the straight tip points up; 90
        /// holds it level, 180 hangs it down.
        pitch_deg: f64 = 0.0, "", -360.0..=360.0, "one turn is enough";
        /// Turn about the base's x axis before the tilt, degrees. Default 0.
        roll_deg: f64 = 0.0, "", -360.0..=360.0, "one turn is enough";
        /// Whether the base carries an IMU of its own, built like the tip's. Default false.
        imu: bool = false;
        /// How the axes of the IMU on the base are turned against those of the tip's at rest, a rotation vector in degrees.
        /// Default 0. The controller does not know it: what it takes for a turn of the base is turned by as much.
        imu_mount_deg: [f64; 3] = [0.0; 3], "", -10.0..=10.0, "within 3° is the plant link's rule";
    }
}

parameters! {
    /// The Earth's magnetic field, north along the world's x.
    FieldConfig at "field" {
        /// Strength, µT. Default 48. A larger value makes every disturbance of the magnetometer smaller in
        /// comparison.
        strength_ut: f64 = 48.0, "", 0.0..=1000.0, "the Earth's is 25 to 65 µT";
        /// Dip below the horizon, degrees. Default 65 (central Europe). A larger value leaves less of the field
        /// for the heading.
        dip_deg: f64 = 65.0, "", -90.0..=90.0, "straight down is 90";
    }
}

parameters! {
    /// `[spread]`: one standard deviation of everything in which units of one make differ.
    Spread at "spread" {
        /// Of each k_ε, as a share. Default 0; 0.06 for a batch of moulded bellows. Units of a larger spread need a
        /// calibration of their own sooner.
        k_epsilon: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each k_λ, as a share. Default 0; 0.1 for printed gears.
        k_lambda: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each bellow's distance from the centre line, as a share. Default 0; 0.01 for a glued tip.
        r: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each bellow's angle, degrees. Default 0; 1 for a glued tip.
        angle_deg: f64 = 0.0, "", 0.0..=6.0, "1 is typical of a glued tip";
        /// Of the lag, as a share. Default 0; 0.2 is plausible.
        lag: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of each effect's size, standard deviation of its logarithm. Default 0; 0.2 within a batch.
        effects: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of the base's pitch and roll, degrees. Default 0; 5 for a hand-held base.
        tilt_deg: f64 = 0.0, "", 0.0..=45.0, "5 is typical of a hand-held base";
        /// Of the base's heading, degrees, evenly spread over ± this. Default 0; 180 for any heading.
        heading_deg: f64 = 0.0, "", 0.0..=180.0, "180 is any heading";
        /// Of the magnetic field's strength, as a share. Default 0; 0.1 indoors.
        field: f64 = 0.0, "", 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot";
        /// Of the field's dip, degrees. Default 0; 4 indoors.
        dip_deg: f64 = 0.0, "", 0.0..=20.0, "4 is typical indoors";
        /// Of each axis' constant gyroscope bias, °/s. Default 0; 0.5 is an uncalibrated chip.
        gyro_bias_deg_s: f64 = 0.0, "", 0.0..=5.0, "0.5 is an uncalibrated chip";
        /// Of each axis' constant accelerometer bias, mg. Default 0; 5 for a chip after a six-face
        /// calibration, 20 for an uncalibrated one.
        acc_bias_mg: f64 = 0.0, "", 0.0..=50.0, "5 is a calibrated chip";
        /// Of each axis' constant magnetometer bias, µT. Default 0; 0.5 for a chip after calibration.
        mag_bias_ut: f64 = 0.0, "", 0.0..=50.0, "0.5 is a calibrated chip";
        /// Of each component of the chip's tilt in the tip, degrees. Default 0; 0.5 for a glued chip.
        mount_deg: f64 = 0.0, "", 0.0..=20.0, "0.5 is a glued chip";
        /// Of the tip's twist at 60° of bend, degrees. Default 0; 1 for a moulded tip.
        torsion_deg: f64 = 0.0, "", 0.0..=20.0, "1 is a moulded tip";
        /// Of the amplitude of each motor's field where the tip is, µT. Default 0; 0.1 for motors half a metre away.
        motor_field_ut: f64 = 0.0, "", 0.0..=50.0, "0.1 is half a metre away";
    }
}

/// The rotation by a vector in degrees.
fn rotation(deg: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::from(deg).map(f64::to_radians))
}

impl BaseConfig {
    /// Attitude of the proximal plate in the world, `Rz(yaw) Ry(pitch) Rx(roll)`.
    pub(crate) fn attitude(&self) -> Rotation<World, Plate> {
        let yaw = rotation([0.0, 0.0, self.yaw_deg]);
        let pitch = rotation([0.0, self.pitch_deg, 0.0]);
        Rotation::assert_frames(yaw * pitch * rotation([self.roll_deg, 0.0, 0.0]))
    }
}

impl FieldConfig {
    /// The field in the world frame, whose x axis points to magnetic north, µT.
    pub fn vector_ut(&self) -> Vector3<f64> {
        let (sin, cos) = self.dip_deg.to_radians().sin_cos();
        Vector3::new(cos, 0.0, -sin) * self.strength_ut
    }
}

impl PlantConfig {
    /// Checks every parameter against the range that the physics supports.
    ///
    /// # Errors
    /// [`Invalid`] for the first parameter outside its range; its key counts from `[plant]`.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.drive.check()?;
        self.line.check()?;
        self.shape.check()?;
        self.base.check()?;
        self.field.check()?;
        self.imu.check()?;
        self.effects.check()?;
        self.spread.check()
    }

    /// The same plant with the named effect at a random size of its typical range: the small end at
    /// severity 0, the large end at 1. A channel, a direction or a time of the effect is random too.
    ///
    /// # Errors
    /// [`PlantError::UnknownEffect`] for a name that [`effect_names`] does not list.
    pub fn with_effect<R: Rng + ?Sized>(
        mut self,
        name: &str,
        severity: f64,
        rng: &mut R,
    ) -> Result<Self, PlantError> {
        let mut rng = PlantRng::new(rng.next_u64(), Stream::Choice);
        if self.effects.draw(name, severity, &mut rng) {
            return Ok(self);
        }
        let known: Vec<_> = effect_names().map(|e| e.name).collect();
        Err(PlantError::UnknownEffect {
            name: name.to_owned(),
            known: known.join(", "),
        })
    }

    /// The same plant with the small imperfections of real units, each below 0.15° of tip orientation and each
    /// present with even odds. Effects that are set already are left alone.
    #[must_use]
    pub fn background<R: Rng + ?Sized>(mut self, rng: &mut R) -> Self {
        let mut rng = PlantRng::new(rng.next_u64(), Stream::Choice);
        self.effects.add_background(&mut rng);
        self
    }

    /// The chip on the base: of the same make as the tip's, with its own mount and no constant bias.
    pub(crate) fn base_imu(&self) -> ImuConfig {
        let turned = rotation(self.imu.mount_deg) * rotation(self.base.imu_mount_deg);
        ImuConfig {
            mount_deg: turned.scaled_axis().map(f64::to_degrees).into(),
            gyro_bias_deg_s: [0.0; 3],
            acc_bias_mg: [0.0; 3],
            mag_bias_ut: [0.0; 3],
            ..self.imu.clone()
        }
    }

    /// What the laws of this plant may depend on.
    pub(crate) fn unit_data(&self, seed: u64) -> UnitData {
        UnitData {
            seed,
            step_mm: self.drive.step_mm,
            microsteps: self.drive.microsteps,
            rest_length_mm: self.shape.rest_length_mm,
            k_epsilon: Vector3::from(self.line.k_epsilon),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand::rngs::Xoshiro256PlusPlus;

    #[test]
    fn the_default_is_valid_and_survives_toml() {
        let config = PlantConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<PlantConfig>(&text).unwrap(), config);
        assert_eq!(toml::from_str::<PlantConfig>("").unwrap(), config);
    }

    #[test]
    fn unknown_names_and_impossible_values_are_refused() {
        let why = toml::from_str::<PlantConfig>("[line]\nk_epsilom = [1, 1, 1]").unwrap_err();
        assert!(why.to_string().contains("k_epsilom"), "{why}");
        let refusal = |text: &str| {
            let plant = toml::from_str::<PlantConfig>(text).unwrap();
            PlantError::from(plant.validate().unwrap_err()).to_string()
        };
        assert!(
            refusal("[line]\nk_epsilon = [1.0, nan, 1.0]")
                .contains("plant.line.k_epsilon[2] = NaN is outside 0 to 20; ")
        );
        assert!(
            refusal("[effects.outside.soft_iron]\nstretch = 0.1\ndirection = [0, 0, 0]")
                .contains("direction length = 0")
        );
        assert!(
            refusal("[effects.missed_steps]\nchannel = 4")
                .contains("plant.effects.missed_steps.channel = 4 is outside 1 to 3")
        );
    }

    #[test]
    fn pitch_lays_the_tip_level() {
        let base = BaseConfig {
            pitch_deg: 90.0,
            ..BaseConfig::default()
        };
        let axis = base.attitude().apply(&Vector3::z());
        assert!((axis - Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn every_draw_is_valid_and_survives_toml() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(1);
        for e in effect_names() {
            for severity in [0.0, 0.5, 1.0] {
                for _ in 0..20 {
                    let config = PlantConfig::default()
                        .with_effect(e.name, severity, &mut rng)
                        .unwrap();
                    config.validate().unwrap();
                    assert_ne!(config, PlantConfig::default(), "{}", e.name);
                    let text = toml::to_string(&config).unwrap();
                    assert_eq!(toml::from_str::<PlantConfig>(&text).unwrap(), config);
                }
            }
        }
        let why = PlantConfig::default()
            .with_effect("gremlins", 0.5, &mut rng)
            .unwrap_err();
        assert!(why.to_string().contains("gremlins") && why.to_string().contains("torsion"));
    }

    #[test]
    fn a_background_leaves_what_is_set() {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(2);
        let set = PlantConfig::default()
            .with_effect("creep", 1.0, &mut rng)
            .unwrap();
        for _ in 0..20 {
            let config = set.clone().background(&mut rng);
            config.validate().unwrap();
            assert_eq!(config.effects.creep, set.effects.creep);
            assert!(config.effects.outside == set.effects.outside);
        }
    }
}
