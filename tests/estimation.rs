//! The tip is felt: the estimator in the closed loop against the generic filters, lying fields, a base
//! that turns.
//!
//! `cargo test --release --test felt -- --nocapture` prints the tables of `docs/fusion.md`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod fake_imu;
mod tip;

use nalgebra::Vector3;
use retroflex::config::assemble;
use retroflex::config::board::Board;
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::control::tick::{Command, Frame, Input, LoopConfig, LoopState, tick};
use retroflex::estimation::fusion::estimator::EstimatorName;
use retroflex::estimation::fusion::health::ImuReading;
use retroflex::model::bend::Bend;
use retroflex::primitives::units::Mm;
use tip::{Field, TipPlant};

const DT_S: f64 = 0.005;

fn config(plant: &TipPlant, filter: EstimatorName) -> LoopConfig {
    let mut config = assemble(&Board::default(), &Calibration::default(), &Gains::default());
    // the calibration of the unit, as good as Algorithm 1 makes it
    config.lines = plant.lines;
    config.fuse.filter = filter;
    config
}

/// A loop on a plant.
struct Life {
    plant: TipPlant,
    config: LoopConfig,
    state: LoopState,
    input: Input,
    with_base_imu: bool,
}

impl Life {
    fn new(plant: TipPlant, filter: EstimatorName) -> Self {
        let config = config(&plant, filter);
        let state = LoopState::new(&config);
        Self { plant, config, state, input: Input { dt_s: DT_S, ..Input::default() }, with_base_imu: false }
    }
    fn tick(&mut self) -> Frame {
        let frame = tick(&self.config, &mut self.state, &self.input);
        self.plant.step(&frame.steps);
        let sample = self.plant.sample();
        let base_imu = self.with_base_imu.then(|| self.plant.base_sample());
        self.input =
            Input { t: sample.t, dt_s: DT_S, imu: ImuReading::from_world(Some(sample)), base_imu, steps: frame.steps, ..Input::default() };
        frame
    }
    fn command(&mut self, bend_deg: f64, dir_deg: f64) {
        self.input.command = Some(Command { bend: Bend::from_deg(bend_deg, dir_deg), length: Mm(20.0) });
    }
    fn run(&mut self, seconds: f64, mut each: impl FnMut(&Frame, &TipPlant)) {
        for _ in 0..(seconds / DT_S).round() as usize {
            let frame = self.tick();
            each(&frame, &self.plant);
        }
    }
    fn align(&mut self) {
        while self.tick().estimate.is_none() {
            assert!(self.plant.t_s < 10.0, "{}", self.state.fusion.waiting_for());
        }
        // a rest after it, as every session has one
        self.run(0.5, |_, _| ());
    }
    /// Bend RMSE over the last 0.3 s of each hold of the paper's schedule, degrees.
    fn paper_rmse_deg(&mut self) -> f64 {
        let (mut sum, mut n) = (0.0, 0u32);
        for dir in (0..360).step_by(30) {
            for bend in [15.0, 30.0, 45.0, 60.0, 75.0, 75.0, 60.0, 45.0, 30.0, 15.0] {
                self.command(bend, f64::from(dir));
                self.run(1.2, |_, _| ());
                self.run(0.3, |_, plant| {
                    sum += (bend - plant.bend().beta().to_degrees()).powi(2);
                    n += 1;
                });
            }
        }
        (sum / f64::from(n)).sqrt()
    }
}

fn rmse(seed: u64, tilt_deg: f64, field: Field, filter: EstimatorName) -> f64 {
    let mut plant = TipPlant::new(seed, tilt_deg, DT_S);
    plant.field = field;
    let mut life = Life::new(plant, filter);
    life.align();
    life.paper_rmse_deg()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The table that decides the loop's default.
#[test]
fn the_bend_estimator_is_the_best_in_the_loop() {
    let cases = [
        ("clean", Field::Clean),
        ("no magnetometer", Field::Silent),
        ("hard iron 15 µT", Field::HardIron(15.0)),
        ("motors 15 µT", Field::Motors(15.0)),
    ];
    let tilts = [20.0, 55.0, 90.0, 125.0, 160.0];
    println!("closed-loop bend RMSE, degrees, over {} attitudes of the base", tilts.len());
    println!("{:18} {}", "", EstimatorName::ALL.map(|c| format!("{:>10}", c.as_str())).concat());
    let mut table = Vec::new();
    for (name, field) in cases {
        let row = EstimatorName::ALL.map(|filter| {
            let each: Vec<f64> = tilts.iter().enumerate().map(|(i, &tilt)| rmse(10 + i as u64, tilt, field, filter)).collect();
            (rms(&each), each.iter().copied().fold(0.0, f64::max))
        });
        println!("{name:18} {}", row.map(|(all, _)| format!("{all:10.2}")).concat());
        println!("{:18} {}", "  worst", row.map(|(_, worst)| format!("{worst:10.2}")).concat());
        table.push(row);
    }
    let best_generic = table[0][1..].iter().map(|r| r.0).fold(f64::INFINITY, f64::min);
    assert!(table[0][0].0 <= 0.8 * best_generic, "{} against {best_generic}", table[0][0].0);
    for row in &table {
        assert!(row[0].1 <= 1.0, "bend at its worst attitude: {}", row[0].1);
    }
}

/// Turns the base by 10° while a pose is held; returns the time until it was flagged and the frame.
fn turned(life: &mut Life, axis: Vector3<f64>, over_s: f64) -> Option<f64> {
    let mut at = None;
    let start = life.plant.t_s;
    life.plant.base_rate = axis.normalize() * (10f64.to_radians() / over_s);
    life.run(over_s, |f, p| at = at.or(f.base_moved.then_some(p.t_s - start)));
    life.plant.base_rate = Vector3::zeros();
    life.run(1.0, |f, p| at = at.or(f.base_moved.then_some(p.t_s - start)));
    at
}

const AXES: [[f64; 3]; 4] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, -0.7, 0.5]];

#[test]
fn a_base_imu_takes_the_turn_of_the_base_off() {
    for (i, axis) in AXES.into_iter().enumerate() {
        let mut life = Life::new(TipPlant::new(30 + i as u64, 50.0, DT_S), EstimatorName::Bend);
        life.with_base_imu = true;
        life.align();
        life.command(40.0, 60.0);
        life.run(2.0, |_, _| ());
        assert_eq!(turned(&mut life, Vector3::from(axis), 0.5), None, "compensated, not flagged");
        let mut after = Vec::new();
        for (bend, dir) in [(40.0, 60.0), (60.0, 180.0), (20.0, 300.0)] {
            life.command(bend, dir);
            life.run(1.2, |_, _| ());
            life.run(0.3, |_, p| after.push((p.bend().0 - Bend::from_deg(bend, dir).0).norm().to_degrees()));
        }
        println!("base turned by 10° about {axis:?}: bend vector off by {:.2}° afterwards", rms(&after));
        assert!(rms(&after) <= 1.5, "{}", rms(&after));
    }
}

#[test]
fn without_a_base_imu_a_turn_is_flagged_and_mended_on_request() {
    for (i, axis) in AXES.into_iter().enumerate() {
        for over_s in [0.2, 0.5, 0.9] {
            let mut life = Life::new(TipPlant::new(40 + i as u64, 50.0, DT_S), EstimatorName::Bend);
            life.align();
            for (bend, dir) in [(30.0, 0.0), (40.0, 60.0)] {
                life.command(bend, dir);
                life.run(2.0, |f, _| assert!(!f.base_moved));
            }
            let at = turned(&mut life, Vector3::from(axis), over_s);
            assert!(at.is_some_and(|t| t <= 1.0), "10° about {axis:?} in {over_s} s: {at:?}");
            let frozen = life.tick().feedback;
            life.run(2.0, |f, _| assert_eq!(f.feedback, frozen, "the integrator stands"));
            life.input.realign = true;
            life.run(4.0, |_, _| ());
            assert!(!life.tick().base_moved, "{}", life.state.fusion.waiting_for());
            let mut after = Vec::new();
            for (bend, dir) in [(40.0, 60.0), (60.0, 180.0), (20.0, 300.0)] {
                life.command(bend, dir);
                life.run(1.2, |_, _| ());
                life.run(0.3, |f, p| {
                    assert!(!f.base_moved);
                    after.push((p.bend().0 - Bend::from_deg(bend, dir).0).norm().to_degrees());
                });
            }
            println!("10° about {axis:?} in {over_s} s: flagged after {:.2} s, {:.2}° after the re-alignment", at.unwrap(), rms(&after));
            assert!(rms(&after) <= 1.5, "{}", rms(&after));
        }
    }
}

#[test]
fn a_base_that_turns_slowly_earns_a_word_and_a_healthy_tip_none() {
    let poses = [(60.0, 0.0), (50.0, 120.0), (60.0, 240.0), (40.0, 60.0), (65.0, 180.0), (55.0, 300.0)];
    for (i, axis) in [[0.0, 0.0, 1.0], [0.5, -0.7, 0.5], [0.3, 0.2, 1.0]].into_iter().enumerate() {
        let mut life = Life::new(TipPlant::new(60 + i as u64, 50.0, DT_S), EstimatorName::Bend);
        life.align();
        let round = |life: &mut Life, seconds: f64| {
            let mut doubted = false;
            for (bend, dir) in poses {
                life.command(bend, dir);
                life.run(seconds / 6.0, |f, _| doubted |= f.base_doubted);
            }
            doubted
        };
        assert!(!round(&mut life, 12.0) && !round(&mut life, 12.0), "nothing has turned");
        life.plant.base_rate = Vector3::from(axis).normalize() * (15f64.to_radians() / 12.0);
        let during = round(&mut life, 12.0);
        life.plant.base_rate = Vector3::zeros();
        let after = round(&mut life, 12.0);
        println!("15° about {axis:?} in 12 s: a word during it {during}, after it {after}");
        assert!(during || after, "{axis:?}");
    }
}
