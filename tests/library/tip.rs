//! A simple tip for the tests of estimation: play, air spring, lag, constant curvature, a moving base, a disturbed
//! field and a nine-axis sensor. All parameters can be changed while it runs.
#![allow(dead_code, reason = "each test uses a part of this module")]

use crate::fake_imu::Motion;
use nalgebra::{UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use retroflex::model::arc::Geometry;
use retroflex::model::bend::Bend;
use retroflex::model::drive::Drive;
use retroflex::model::transmission::Line;
use retroflex::motion::steps::count;
use retroflex::motion::{Motion as Pistons, MotionLimits};
use retroflex::primitives::frames::{Base, Rotation, Tip};
use retroflex::primitives::sample::ImuSample;
use retroflex::primitives::units::{Seconds, Steps};

pub const GRAVITY: f64 = 9.81;

/// Disturbance of the Earth's field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Field {
    /// None.
    Clean,
    /// The magnetometer delivers no values.
    Silent,
    /// Iron on the tip, µT.
    HardIron(f64),
    /// Motor coils, fixed in the world, whose field follows the microsteps, µT.
    Motors(f64),
}

/// One sensor's noise and bias, 1 σ per axis.
pub const GYRO_NOISE: f64 = 0.0022;
pub const ACC_NOISE: f64 = 0.02;
pub const MAG_NOISE: f64 = 0.35;

pub struct TipPlant {
    pub t_s: f64,
    pub dt_s: f64,
    pub lines: [Line; 3],
    pub lag_s: f64,
    pub geometry: Geometry,
    pub drive: Drive,
    /// Base in the world.
    pub base: UnitQuaternion<f64>,
    pub field: Field,
    pub acc_bias: Vector3<f64>,
    pub gyro_bias: Vector3<f64>,
    /// Rate of the base, rad/s, world axes.
    pub base_rate: Vector3<f64>,
    /// Additional specific force, m/s², tip axes.
    pub push: Vector3<f64>,
    /// Additional bend by an external cause, rad.
    pub aside: nalgebra::Vector2<f64>,
    play_output: Vector3<f64>,
    bellow: Vector3<f64>,
    bend: Bend,
    before: UnitQuaternion<f64>,
    /// Positions of the sensor in the base at this and the two previous steps, m.
    positions: [Vector3<f64>; 3],
    steps: Steps,
    pistons: Pistons,
    n: u64,
    rng: StdRng,
}

fn field_world() -> Vector3<f64> {
    Vector3::new(20.0, 0.0, -44.0)
}

/// Position of the sensor, 6 mm past the end of an arc of 20 mm, m.
fn position(bend: &Bend) -> Vector3<f64> {
    let beta = bend.beta().max(1e-9);
    let (x, z) = (
        20.0 * (1.0 - beta.cos()) / beta + 6.0 * beta.sin(),
        20.0 * beta.sin() / beta + 6.0 * beta.cos(),
    );
    Vector3::new(x * bend.0.x / beta, -x * bend.0.y / beta, z) * 1e-3
}

impl TipPlant {
    /// A tip whose base axis is tilted by `tilt_deg` from the vertical; azimuth and heading depend on the seed.
    pub fn new(seed: u64, tilt_deg: f64, dt_s: f64) -> Self {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut unit = || -> f64 { rand::RngExt::random(&mut rng) };
        let (azimuth, heading) = (
            unit() * std::f64::consts::TAU,
            unit() * std::f64::consts::TAU,
        );
        let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let base = UnitQuaternion::from_scaled_axis(Vector3::z() * heading)
            * UnitQuaternion::from_scaled_axis(axis * tilt_deg.to_radians());
        let lines = [2.22, 2.53, 2.21].map(|k| Line {
            k_epsilon: k * (0.95 + 0.1 * unit()),
            k_lambda_mm: 0.8 + 0.12 * unit(),
        });
        let gyro_bias = Vector3::from_fn(|_, _| 0.02 * (unit() - 0.5));
        Self {
            t_s: 0.0,
            dt_s,
            lines,
            lag_s: 0.03,
            geometry: Geometry {
                r_mm: 7.0 / 3f64.sqrt(),
                rest_length_mm: 20.0,
            },
            drive: Drive::default(),
            base,
            field: Field::Clean,
            acc_bias: Vector3::new(0.05, -0.04, 0.06),
            gyro_bias,
            base_rate: Vector3::zeros(),
            push: Vector3::zeros(),
            aside: nalgebra::Vector2::zeros(),
            play_output: Vector3::zeros(),
            bellow: Vector3::zeros(),
            bend: Bend::STRAIGHT,
            before: base,
            positions: [position(&Bend::STRAIGHT); 3],
            steps: Steps::default(),
            pistons: Pistons::new(&MotionLimits::default()),
            n: 0,
            rng,
        }
    }

    /// One period in which the pistons move towards `wanted`; returns the counts that they reach.
    pub fn step(&mut self, wanted: &Steps) -> Steps {
        let moved = self
            .pistons
            .tick(self.drive.piston_mm(wanted).into(), self.dt_s)
            .end();
        let steps = Steps(moved.map(|state| count(state.position_mm, self.drive.step_mm)));
        let piston = self.drive.piston_mm(&steps);
        let keep = (-self.dt_s / self.lag_s).exp();
        for i in 0..3 {
            self.play_output[i] = self.lines[i].play(self.play_output[i], piston[i]);
            let q = self.lines[i].bellow_mm(self.play_output[i]);
            self.bellow[i] = q + (self.bellow[i] - q) * keep;
        }
        self.before = self.base * self.bend.rotation().quat();
        self.bend = Bend(self.geometry.shape(&self.bellow).bend.0 + self.aside);
        self.positions = [position(&self.bend), self.positions[0], self.positions[1]];
        self.base = UnitQuaternion::from_scaled_axis(self.base_rate * self.dt_s) * self.base;
        (self.steps, self.n, self.t_s) = (steps, self.n + 1, self.t_s + self.dt_s);
        steps
    }

    pub fn truth(&self) -> Rotation<Base, Tip> {
        self.bend.rotation()
    }
    pub fn bend(&self) -> Bend {
        self.bend
    }

    /// Motion of the tip as an ideal sensor measures it.
    pub fn motion(&self) -> Motion {
        let now = self.base * self.bend.rotation().quat();
        let back = now.inverse();
        let mut field = back * (field_world() + self.coils());
        if let Field::HardIron(ut) = self.field {
            field += Vector3::new(0.6, -0.64, 0.48) * ut;
        }
        Motion {
            acc_m_s2: back * (Vector3::new(0.0, 0.0, GRAVITY) + self.base * self.acceleration())
                + self.acc_bias
                + self.push,
            gyro_rad_s: (self.before.inverse() * now).scaled_axis() / self.dt_s + self.gyro_bias,
            mag_ut: field,
            temp_c: 25.0,
        }
    }

    /// Second difference of the position of the sensor, m/s², base axes.
    fn acceleration(&self) -> Vector3<f64> {
        let [now, before, earlier] = self.positions;
        (now - before * 2.0 + earlier) / (self.dt_s * self.dt_s)
    }

    fn coils(&self) -> Vector3<f64> {
        let Field::Motors(ut) = self.field else {
            return Vector3::zeros();
        };
        let axes = [
            Vector3::new(0.8, 0.6, 0.0),
            Vector3::new(-0.36, 0.48, 0.8),
            Vector3::new(0.0, -0.6, 0.8),
        ];
        axes.iter()
            .enumerate()
            .map(|(i, a)| {
                a * (ut * (f64::from(self.steps.0[i]) * std::f64::consts::TAU / 64.0).cos())
            })
            .sum()
    }

    fn noise(&mut self, sigma: f64) -> Vector3<f64> {
        let rng = &mut self.rng;
        Vector3::from_fn(|_, _| {
            sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng)
        })
    }

    /// The sample of a noisy sensor, with a field value in every second one.
    pub fn sample(&mut self) -> ImuSample {
        let m = self.motion();
        let mag = (self.field != Field::Silent && self.n.is_multiple_of(2))
            .then(|| m.mag_ut + self.noise(MAG_NOISE));
        ImuSample {
            t: Seconds(self.t_s),
            gyro_rad_s: m.gyro_rad_s + self.noise(GYRO_NOISE),
            acc_m_s2: m.acc_m_s2 + self.noise(ACC_NOISE),
            mag_ut: mag,
        }
    }

    /// The sample of a second sensor on the base with the same mounting.
    pub fn base_sample(&mut self) -> ImuSample {
        let back = self.base.inverse();
        ImuSample {
            t: Seconds(self.t_s),
            gyro_rad_s: back * self.base_rate
                + Vector3::new(-0.01, 0.004, 0.007)
                + self.noise(GYRO_NOISE),
            acc_m_s2: back * Vector3::new(0.0, 0.0, GRAVITY) + self.noise(ACC_NOISE),
            mag_ut: Some(back * field_world() + self.noise(MAG_NOISE)),
        }
    }
}
