//! Moves the pistons of a plant and records its output.

use nalgebra::{Vector2, Vector3};
use retroflex::model::bend::Bend;
use retroflex::model::drive::Drive;
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::imu::chip::ImuConfig;
use retroflex::simulation::plant::{Output, Plant, PlantConfig};

/// Default step of the rig, s.
pub const DT_S: f64 = 0.001;

/// A plant and the commanded piston positions.
pub struct Rig {
    pub plant: Plant,
    pub dt_s: f64,
    drive: Drive,
    at_mm: Vector3<f64>,
}

/// A plant configuration from the text of a file.
pub fn config(toml: &str) -> PlantConfig {
    toml::from_str(toml).unwrap()
}

/// A chip without noise, wander and quantisation.
pub fn perfect_imu() -> ImuConfig {
    ImuConfig {
        gyro_noise_deg_s_rthz: 0.0,
        acc_noise_mg_rthz: 0.0,
        mag_noise_ut: 0.0,
        gyro_wander_deg_s: 0.0,
        acc_wander_mg: 0.0,
        mag_wander_ut: 0.0,
        gyro_digit_deg_s: 0.0,
        acc_digit_mg: 0.0,
        mag_digit_ut: 0.0,
        ..ImuConfig::default()
    }
}

/// A piston pattern that bends to direction 0 by shortening bellow 1.
pub const BEND: [f64; 3] = [-10.0, 5.0, 5.0];

impl Rig {
    pub fn new(config: &PlantConfig) -> Self {
        let drive = Drive {
            step_mm: config.drive.step_mm,
        };
        Self {
            plant: Plant::new(config, 11).unwrap(),
            dt_s: DT_S,
            drive,
            at_mm: Vector3::zeros(),
        }
    }
    pub fn of(toml: &str) -> Self {
        Self::new(&config(toml))
    }
    /// Without play and with a noise-free IMU, for exact comparisons.
    pub fn clean(toml: &str) -> Self {
        let mut c = config(toml);
        c.line.k_lambda_mm = [0.0; 3];
        c.imu = ImuConfig {
            gyro_bias_deg_s: c.imu.gyro_bias_deg_s,
            ..perfect_imu()
        };
        Self::new(&c)
    }
    fn counts(&self) -> Steps {
        self.drive.steps(&self.at_mm)
    }
    /// Straight to `to_mm` at `speed_mm_s` of the fastest piston.
    pub fn go(&mut self, to_mm: [f64; 3], speed_mm_s: f64) -> Vec<Output> {
        let (from, to) = (self.at_mm, Vector3::from(to_mm));
        let n = ((to - from).amax() / speed_mm_s / self.dt_s)
            .ceil()
            .max(1.0) as usize;
        (1..=n)
            .map(|k| {
                self.at_mm = from.lerp(&to, k as f64 / n as f64);
                self.plant.step(&self.counts(), self.dt_s)
            })
            .collect()
    }
    /// Holds the position.
    pub fn hold(&mut self, seconds: f64) -> Vec<Output> {
        (0..(seconds / self.dt_s).round() as usize)
            .map(|_| self.plant.step(&self.counts(), self.dt_s))
            .collect()
    }
    /// Moves, waits a second, and returns the bend vector, degrees.
    pub fn at(&mut self, to_mm: [f64; 3]) -> Vector2<f64> {
        self.go(to_mm, 20.0);
        bend(self.hold(1.0).last().unwrap())
    }
    /// Commanded piston positions, mm.
    pub fn sent_mm(&self) -> Vector3<f64> {
        self.at_mm
    }
}

/// True bend vector, degrees.
pub fn bend(out: &Output) -> Vector2<f64> {
    Bend::from_rotation(&out.truth.r_base_tip)
        .0
        .map(f64::to_degrees)
}

/// Some motion of all channels with holds between, the same for every plant.
pub fn wander(rig: &mut Rig) -> Vec<Output> {
    let mut out = rig.hold(2.5);
    for to in [
        [-10.0, 5.0, 5.0],
        [2.0, 2.0, -9.0],
        [8.0, -6.0, 1.0],
        [-4.0, -3.0, -2.0],
        [12.0, -14.0, 3.0],
        [0.0, 0.0, 0.0],
    ] {
        out.extend(rig.go(to, 20.0));
        out.extend(rig.hold(1.0));
    }
    out
}
