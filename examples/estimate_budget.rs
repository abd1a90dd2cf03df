//! The error of the estimated bend, whether its covariance is honest, and where the error comes from:
//! `cargo run --release --example estimate_budget -- [SEED [UNITS]]`.
//!
//! Every row runs the closed loop on drawn units of the paper twin under a condition of `evaluate --sweep`, in four directions,
//! and prints over the scored part of the 40 held states: the RMS error of the estimated bend angle over all units and of the worst
//! unit; error² / σ² of the bend vector, of the accelerometer's bias and of the tip's iron at the end, each per degree of freedom (the
//! mean over the units, and the least and the largest unit); and the mean probability of each hypothesis. Then the budget: the twin
//! without each source of error, and with it alone.
#![allow(
    clippy::expect_used,
    reason = "a tool that may stop at the first error"
)]

use nalgebra::Vector3;
use rayon::prelude::*;
use retroflex::config::{Board, Calibration, Gains, assemble, source};
use retroflex::control::LoopConfig;
use retroflex::experiment::evaluation::{Arm, for_world};
use retroflex::experiment::rig::Rig;
use retroflex::experiment::schedule::{HOLD_S, Pose, SCORED_S, arrivals};
use retroflex::experiment::sweep::{CONDITIONS, DIRECTIONS, Study, TURN_DEG};
use retroflex::model::{Bend, Shape};
use retroflex::primitives::Mm;
use retroflex::simulation::plant::PlantConfig;
use retroflex::simulation::sim::Sim;

/// Figures of one unit; angles in degrees, squares per degree of freedom.
#[derive(Debug, Clone, Copy, Default)]
struct Figures {
    error_sq: f64,
    bend: f64,
    acc_bias: f64,
    iron: f64,
    hypotheses: [f64; 5],
}

/// A source of error and how to remove it.
type Source = (&'static str, fn(&mut PlantConfig));

const SOURCES: [Source; 7] = [
    ("gyroscope noise", |p| {
        (p.imu.gyro_noise_deg_s_rthz, p.imu.gyro_digit_deg_s) = (0.0, 0.0);
    }),
    ("gyroscope bias", |p| {
        (p.imu.gyro_bias_deg_s, p.imu.gyro_wander_deg_s) = ([0.0; 3], 0.0);
        p.effects.gyro_bias = None;
    }),
    ("accelerometer", |p| {
        (p.imu.acc_bias_mg, p.imu.acc_noise_mg_rthz) = ([0.0; 3], 0.0);
        (p.imu.acc_wander_mg, p.imu.acc_digit_mg) = (0.0, 0.0);
        p.effects.accel_bias = None;
    }),
    ("field", |p| {
        (p.imu.mag_bias_ut, p.imu.mag_noise_ut) = ([0.0; 3], 0.0);
        (p.imu.mag_wander_ut, p.imu.mag_digit_ut) = (0.0, 0.0);
        (p.effects.motor_field, p.effects.hard_iron) = (None, None);
    }),
    ("mount", |p| p.effects.mount_misalignment = None),
    ("torsion", |p| p.effects.torsion = None),
    ("creep and leak", |p| {
        (p.effects.creep, p.effects.leak) = (None, None)
    }),
];

/// The closed loop on one unit.
fn run(config: &LoopConfig, unit: &PlantConfig, period_s: f64, noise: u64) -> Figures {
    let mut world = Sim::new(unit, 0, noise, period_s).expect("the unit is valid");
    let mut rig = Rig::new(Arm::Closed.config(&for_world(config, &world)), &mut world);
    rig.align().expect("the tip is still");
    let (mut figures, mut n) = (Figures::default(), 0.0);
    for pose in arrivals(DIRECTIONS) {
        hold(&mut rig, &pose, &mut figures, &mut n);
    }
    let filter = rig.state.fusion.estimator().and_then(|e| e.as_bend());
    let filter = filter.expect("the default estimator is `bend`");
    let per_axis = |error: Vector3<f64>, sigma: f64| (error / sigma).norm_squared() / 3.0;
    let mg = 9.81e-3;
    // the margins are three standard deviations
    let known = filter.known_errors();
    let (acc, acc_sigma) = (known.acc_bias_m_s2, known.acc_margin_m_s2 / 3.0);
    let (iron, iron_sigma) = (known.iron_ut, known.iron_margin_ut / 3.0);
    let offset = unit
        .effects
        .hard_iron
        .as_ref()
        .map_or([0.0; 3], |h| h.offset_ut);
    let magnet = Vector3::from(unit.imu.mag_bias_ut) + Vector3::from(offset);
    Figures {
        error_sq: figures.error_sq / n,
        bend: figures.bend / n,
        acc_bias: per_axis(acc - Vector3::from(unit.imu.acc_bias_mg) * mg, acc_sigma),
        iron: per_axis(iron - magnet, iron_sigma),
        hypotheses: figures.hypotheses.map(|p| p / n),
    }
}

/// Holds a pose and adds its scored part.
fn hold(rig: &mut Rig<'_>, pose: &Pose, figures: &mut Figures, n: &mut f64) {
    let ticks = (HOLD_S / rig.period_s()).round() as usize;
    let scored_from = ticks - (SCORED_S / rig.period_s()).round() as usize;
    let mut command = Some(Shape {
        bend: pose.bend(),
        length: Mm(rig.config.geometry.rest_length_mm),
    });
    let mut truth = Bend::STRAIGHT;
    for k in 0..ticks {
        let (frame, sensed) = rig.advance(command.take()).expect("the world runs");
        let filter = rig.state.fusion.estimator().and_then(|e| e.as_bend());
        if let (true, true, Some(estimate), Some(filter)) =
            (pose.scored, k >= scored_from, frame.estimate, filter)
        {
            // the estimate is of the sample before this turn
            let error = estimate.bend.0 - truth.0;
            let angle = estimate.bend.beta() - truth.beta();
            figures.error_sq += angle.to_degrees().powi(2);
            let covariance = rig.state.fusion.covariance();
            let inverse = covariance.try_inverse().unwrap_or_default();
            figures.bend += error.dot(&(inverse * error)) / 2.0;
            for (sum, p) in figures.hypotheses.iter_mut().zip(filter.probabilities()) {
                *sum += p;
            }
            *n += 1.0;
        }
        truth = Bend::nearest(&sensed.truth.expect("the built-in plant has a reference"));
    }
}

fn print(name: &str, units: &[Figures]) {
    let mean = |f: &dyn Fn(&Figures) -> f64| units.iter().map(f).sum::<f64>() / units.len() as f64;
    let worst = units.iter().map(|u| u.error_sq.sqrt()).fold(0.0, f64::max);
    let z = |f: fn(&Figures) -> f64| {
        let (low, high) = units
            .iter()
            .map(f)
            .fold((f64::INFINITY, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
        format!("{:6.2} [{low:.2}, {high:.2}]", mean(&f))
    };
    let p: Vec<String> = (0..units[0].hypotheses.len())
        .map(|j| format!("{:.2}", mean(&|u: &Figures| u.hypotheses[j])))
        .collect();
    println!(
        "{name:38} {:6.3} {worst:6.3}   {:24} {:22} {:22} {}",
        mean(&|u: &Figures| u.error_sq).sqrt(),
        z(|u| u.bend),
        z(|u| u.acc_bias),
        z(|u| u.iron),
        p.join(" "),
    );
}

fn main() {
    let number = |i: usize, default: u64| {
        let given = std::env::args().nth(i);
        given.map_or(default, |a| a.parse().expect("SEED and UNITS are numbers"))
    };
    let (seed, units) = (number(1, 700), number(2, 5));
    let read =
        |path: &str| std::fs::read_to_string(path).expect("run it in the folder of the repository");
    let board: Board = source::parse("boards/sim.toml", &read("boards/sim.toml"))
        .expect("boards/sim.toml is valid");
    let calib: Calibration = source::parse("calib/paper.toml", &read("calib/paper.toml"))
        .expect("calib/paper.toml is valid");
    let plant = board.plant.clone().expect("boards/sim.toml has a plant");
    let study = Study {
        config: assemble(&board, &calib, &Gains::default()),
        make: plant.clone(),
        seed,
        units,
    };
    let row = |name: &str, change: &(dyn Fn(&mut PlantConfig, u64) + Sync)| {
        let one = |n: u64| {
            let mut unit = study.unit(n);
            change(&mut unit, n);
            run(
                &study.config,
                &unit,
                study.make.period_s,
                10 * (seed + n) + Arm::Closed as u64,
            )
        };
        let all: Vec<Figures> = (0..units).into_par_iter().map(one).collect();
        print(name, &all);
    };
    println!("seed {seed}, {units} units a row");
    println!(
        "{:38} {:>6} {:>6}   {:24} {:22} {:22} steady drifts wrong-rate sways",
        "", "RMS °", "worst", "bend error²/σ²", "acc. bias", "iron"
    );
    row("undisturbed", &|_, _| ());
    for condition in &CONDITIONS {
        for &value in condition.values {
            row(&format!("{} = {value}", condition.name), &|unit, n| {
                (condition.apply)(unit, value, TURN_DEG * n as f64 % 360.0);
            });
        }
    }
    row("every source off", &|unit, _| {
        SOURCES.iter().for_each(|(_, off)| off(unit))
    });
    for (name, off) in SOURCES {
        row(&format!("without {name}"), &|unit, _| off(unit));
    }
    for (i, (name, _)) in SOURCES.iter().enumerate() {
        row(&format!("only {name}"), &|unit, _| {
            let others = SOURCES.iter().enumerate().filter(|(k, _)| *k != i);
            others.for_each(|(_, (_, off))| off(unit));
        });
    }
}
