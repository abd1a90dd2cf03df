//! The machine that a diagnosis describes as a [`World`]: the nominal model with the recalibrated gains and the saved effects,
//! and nothing else.
//!
//! It runs the catalogue's laws, with which it was diagnosed, and is therefore no test of the diagnosis; the built-in plant has
//! laws of its own.

use crate::model::effects::{ImuPrediction, Memory, Moment};
use crate::model::{DescribedMachine, orientation};
use crate::motion::{MachineError, MachineInfo};
use crate::primitives::{ImuSample, Rotation, Seconds, Steps};
use crate::simulation::world::{Reply, World};
use nalgebra::{UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use std::collections::VecDeque;

/// Period of the world and of its IMU, s.
const PERIOD_S: f64 = 0.005;
/// White noise of a sample: m/s², rad/s, µT.
const NOISE: [f64; 3] = [0.02, 0.002, 0.3];
/// Gravity, m/s².
const G_M_S2: f64 = 9.80665;

/// A running machine.
#[derive(Debug)]
pub struct Described {
    machine: DescribedMachine,
    info: MachineInfo,
    memory: Vec<Memory>,
    rng: StdRng,
    periods: u64,
    last: Steps,
    idle_s: f64,
    /// Counts of the last dead time, the oldest first.
    counts: VecDeque<Steps>,
    /// Readings of the last latency, the oldest first.
    samples: VecDeque<ImuSample>,
    /// Number of periods by which a reading is late.
    late: usize,
    play_output_mm: Vector3<f64>,
    lagged_mm: Vector3<f64>,
    rest: UnitQuaternion<f64>,
    before: UnitQuaternion<f64>,
}

impl Described {
    /// The machine at rest, with the noise of `seed`.
    pub fn new(machine: DescribedMachine, step_mm: f64, seed: u64) -> Self {
        let mut memory = machine.memory();
        let chain = machine.chain();
        let at = chain.moment(machine.rest.up, PERIOD_S);
        let rest = orientation(&chain.pose(&mut memory, &at, &Vector3::zeros()));
        let periods = |time_s: f64| (time_s / PERIOD_S).round() as usize;
        let late: f64 = chain.each().map(|(e, p)| e.latency_s(p)).sum();
        let behind: f64 = chain.each().map(|(e, p)| e.transport_s(p)).sum();
        Self {
            info: MachineInfo {
                name: "model".to_owned(),
                period_s: PERIOD_S,
                step_mm,
                rest_length_mm: machine.geometry.rest_length_mm,
            },
            memory: machine.memory(),
            rng: StdRng::seed_from_u64(seed),
            periods: 0,
            idle_s: f64::INFINITY,
            last: Steps::default(),
            counts: vec![Steps::default(); periods(behind)].into(),
            samples: VecDeque::new(),
            late: periods(late),
            play_output_mm: Vector3::zeros(),
            lagged_mm: Vector3::zeros(),
            rest,
            before: UnitQuaternion::identity(),
            machine,
        }
    }

    /// Tip orientation relative to rest after one more period with the pistons at `counted_mm`.
    fn turn(&mut self, at: &Moment) -> UnitQuaternion<f64> {
        let chain = self.machine.chain();
        let piston_mm = chain.pistons(&mut self.memory, at, &at.counted_mm);
        self.play_output_mm = chain.play(&self.play_output_mm, &piston_mm);
        let bellow_mm = chain.bellows(&mut self.memory, at, &self.play_output_mm);
        self.lagged_mm = bellow_mm
            + (self.lagged_mm - bellow_mm) * (-PERIOD_S / self.machine.lag_s().max(1e-3)).exp();
        self.rest.inverse() * orientation(&chain.pose(&mut self.memory, at, &self.lagged_mm))
    }

    /// What the IMU reads with the tip at `tip`.
    fn read(&mut self, tip: &UnitQuaternion<f64>, at: &Moment) -> ImuSample {
        let (machine, rest) = (&self.machine, self.machine.rest);
        let chain = machine.chain();
        let turned = chain.each().find_map(|(e, p)| e.base(p, at));
        let mounts = chain.each().filter_map(|(e, p)| e.mount(p));
        let mount = mounts.fold(UnitQuaternion::identity(), |a, b| a * b);
        let sensor = turned.unwrap_or_default() * tip * mount;
        let mut reading = ImuPrediction {
            acc_m_s2: sensor.inverse() * rest.up * G_M_S2,
            gyro_rad_s: (self.before.inverse() * sensor).scaled_axis() / PERIOD_S
                + rest.gyro_bias_rad_s,
            mag_ut: sensor.inverse() * rest.field_ut,
            r_base_sensor: sensor,
        };
        if self.periods == 1 {
            reading.gyro_rad_s = rest.gyro_bias_rad_s;
        }
        self.before = sensor;
        for ((e, p), memory) in chain.each().zip(&mut self.memory) {
            e.sensor(p, memory, at, &mut reading);
        }
        let mut noise =
            |size: f64| Vector3::from_fn(|_, _| size * self.rng.sample::<f64, _>(StandardNormal));
        ImuSample {
            t: Seconds(at.t_s),
            acc_m_s2: reading.acc_m_s2 + noise(NOISE[0]),
            gyro_rad_s: reading.gyro_rad_s + noise(NOISE[1]),
            // a log without a magnetometer says nothing about the field
            mag_ut: (rest.field_ut.norm() > 0.0).then(|| reading.mag_ut + noise(NOISE[2])),
        }
    }
}

impl World for Described {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError> {
        self.periods += 1;
        self.counts.push_back(*steps);
        let counted = self.counts.pop_front().unwrap_or(*steps);
        let counted_mm = Vector3::from(counted.0.map(f64::from)) * self.info.step_mm;
        let chain = self.machine.chain();
        let idle = self.last == *steps;
        self.idle_s = if idle { self.idle_s + PERIOD_S } else { 0.0 };
        self.last = *steps;
        let t_s = self.periods as f64 * PERIOD_S;
        let at = Moment {
            t_s,
            counted_mm,
            idle_s: self.idle_s,
            ..chain.moment(self.machine.rest.up, PERIOD_S)
        };
        let tip = self.turn(&at);
        let sample = self.read(&tip, &at);
        self.samples.push_back(sample);
        // before the first late reading the sensor repeats its reading at rest
        let imu = if self.samples.len() > self.late {
            self.samples.pop_front()
        } else {
            self.samples.front().copied()
        };
        let t = Seconds(at.t_s);
        Ok(Reply {
            imu: imu.map(|s| ImuSample { t, ..s }),
            base_imu: None,
            truth: Some(Rotation::assert_frames(tip)),
        })
    }
}
