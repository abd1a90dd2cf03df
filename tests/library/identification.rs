//! Transmission gains: Algorithm 1, short calibration and online refinement.

use crate::common::{identified, plain, repo, uncalibrated, unit};
use nalgebra::{Vector2, Vector3};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use retroflex::config::calib::Calibration;
use retroflex::config::source;
use retroflex::control::learning::batch::Prior;
use retroflex::control::learning::identify::Identified;
use retroflex::control::learning::schedule::{HOLD_S, arrivals, paper, short};
use retroflex::control::tick::LoopConfig;
use retroflex::experiment::arm;
use retroflex::experiment::evaluation::for_world;
use retroflex::experiment::identify::algorithm_1;
use retroflex::experiment::rig::Rig;
use retroflex::model::arc::Shape;
use retroflex::model::bend::Bend;
use retroflex::model::transmission::Line;
use retroflex::primitives::units::Mm;
use retroflex::simulation::sim::Sim;
use retroflex::simulation::world::World;

/// k_ε of every channel at the poses of the closed loop: least squares on the play outputs of the counted steps and the
/// true bellow lengths. The closed loop bends the tip further in its stiff direction than the same gains do in open loop,
/// so these differ from the gains of Algorithm 1.
fn effective_closed(config: &LoopConfig, mut world: Sim) -> [f64; 3] {
    let (mut play_output, mut square, mut product) = (
        Vector3::<f64>::zeros(),
        Vector3::<f64>::zeros(),
        Vector3::<f64>::zeros(),
    );
    let mut rig = Rig::new(config.clone(), &mut world);
    rig.align().unwrap();
    for pose in paper() {
        let mut command = Some(Shape {
            bend: pose.bend(),
            length: Mm(config.geometry.rest_length_mm),
        });
        let mut bend = Bend::STRAIGHT;
        for _ in 0..(HOLD_S / rig.period_s()).round() as usize {
            let sensed = rig.advance(command.take()).unwrap().1;
            bend = Bend::nearest(&sensed.truth.unwrap());
            let piston = config.drive.piston_mm(&sensed.counted);
            play_output = Vector3::from_fn(|i, _| config.lines[i].play(play_output[i], piston[i]));
        }
        let q = config.geometry.lengths(&Shape {
            bend,
            length: Mm(config.geometry.rest_length_mm),
        });
        square += q.component_mul(&q);
        product += q.component_mul(&(play_output - q));
    }
    [0, 1, 2].map(|i| product[i] / square[i])
}

/// 24 poses with the paper's gains as prior, and 120 poses without prior, on the same unit from the same start.
fn short_and_full(seed: u64, open: fn(u64, u64) -> Sim) -> [Identified; 2] {
    let prior = source::read::<Calibration>(&repo("calib/paper.toml"))
        .unwrap()
        .prior();
    let alone = prior.map(|p| Prior {
        k_epsilon_sigma: 1e3,
        k_lambda_sigma_mm: 1e3,
        ..p
    });
    let config = for_world(&uncalibrated(), &open(seed, 0));
    [(short(24), prior), (paper(), alone)].map(|(poses, prior)| {
        let mut world = open(seed, 60);
        algorithm_1(&config, &mut world, &poses, Some(&prior), &mut |_| ()).unwrap()
    })
}

#[test]
fn a_short_calibration_agrees_with_a_full_one() {
    for seed in 1..=8 {
        let [brief, full] = short_and_full(seed, plain);
        let off = largest_change(&brief.lines(), &full.lines());
        assert!(off < 0.03, "unit {seed}: {:.1} %", 100.0 * off);
    }
}

/// The gain of the twin depends on pose and time, because of its cable and because its air warms: the two differ by up to 18 %.
#[test]
fn the_interval_of_a_short_calibration_holds_the_gain_of_a_full_one_on_the_twin() {
    let (mut squares, mut outside_alone) = (Vec::new(), 0);
    for seed in 401..=410 {
        let [brief, full] = short_and_full(seed, unit);
        for i in 0..3 {
            let [k, k_full] = [&brief, &full].map(|found| found.lines()[i].k_epsilon);
            let sigma = brief.later_sigmas()[i];
            let sigma_full = full.channels[i].covariance[(0, 0)].sqrt();
            println!(
                "unit {seed}, line {i}: {k:.2} ± {sigma:.2}, 120 poses {k_full:.2} ± {sigma_full:.2}"
            );
            squares.push(((k - k_full) / sigma.hypot(sigma_full)).powi(2));
            let alone = brief.channels[i].covariance[(0, 0)].sqrt();
            outside_alone += usize::from((k - k_full).abs() > 1.96 * alone.hypot(sigma_full));
        }
    }
    let outside = squares.iter().filter(|z_2| **z_2 > 1.96 * 1.96).count();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    println!(
        "{outside} of {} outside 95 %, mean square {mean:.2}; {outside_alone} by the covariance alone",
        squares.len()
    );
    assert!(
        outside <= 1 && mean > 0.25,
        "{outside} outside, mean square {mean:.2}"
    );
}

fn largest_change(a: &[Line; 3], b: &[Line; 3]) -> f64 {
    (0..3)
        .map(|i| (a[i].k_epsilon / b[i].k_epsilon - 1.0).abs())
        .fold(0.0, f64::max)
}

#[test]
#[ignore = "known limitation: k_λ is learned too, and against k_ε at the calibrated k_λ one channel ends 9.7 % off from the right gain (3.5 % from 0.7)"]
fn a_gain_30_percent_off_converges_to_5_percent_in_one_experiment() {
    let (config, found) = identified(1);
    let truth = effective_closed(&config, unit(1, 71));
    println!(
        "open loop {:?}, at the closed loop's poses {truth:?}",
        found.lines().map(|l| l.k_epsilon)
    );
    for by in [0.7, 1.0, 1.3] {
        let mut world = unit(1, 70);
        let start = [0, 1, 2].map(|i: usize| Line {
            k_epsilon: by * truth[i],
            ..found.lines()[i]
        });
        let mut rig = Rig::new(
            LoopConfig {
                lines: start,
                ..config.clone()
            },
            &mut world,
        );
        let result = arm::run("closed", &mut rig, &arrivals(12), &mut || ()).unwrap();
        let end = rig.state.lines().map(|l| l.k_epsilon);
        let off = (0..3)
            .map(|i| (end[i] / truth[i] - 1.0).abs())
            .fold(0.0, f64::max);
        println!(
            "from {by}: {end:?}, error {:.1} %, bend RMSE {:.2}°",
            100.0 * off,
            result.bend_rmse_deg
        );
        assert!(off < 0.05, "from {by}: {end:?} against {truth:?}");
        assert!(result.bend_rmse_deg < 1.0);
    }
}

/// Commands a bend and waits.
fn hold(rig: &mut Rig<'_>, bend: Bend, seconds: f64) {
    let mut command = Some(Shape {
        bend,
        length: Mm(rig.config.geometry.rest_length_mm),
    });
    for _ in 0..(seconds / rig.period_s()).round() as usize {
        rig.advance(command.take()).unwrap();
    }
}

#[test]
fn ten_minutes_of_holding_do_not_change_the_gains() {
    let (config, _) = identified(1);
    let mut world = unit(1, 80);
    let mut rig = Rig::new(config, &mut world);
    rig.align().unwrap();
    for pose in paper().into_iter().take(25) {
        hold(&mut rig, pose.bend(), HOLD_S);
    }
    let pose = paper()[28];
    hold(&mut rig, pose.bend(), HOLD_S);
    let before = *rig.state.lines();
    hold(&mut rig, pose.bend(), 600.0);
    let moved = largest_change(rig.state.lines(), &before);
    println!("k_ε moved by {:.2} %", 100.0 * moved);
    assert!(moved < 0.01, "{before:?} became {:?}", rig.state.lines());
}

#[test]
#[ignore = "known limitation: on the twin, whose gain depends on pose and time, the mean k_ε of the second hour differs by 6.4 % from the first, asked 5 %"]
fn two_hours_of_random_commands_do_not_diverge() {
    let (config, _) = identified(1);
    let truth = effective_closed(&config, unit(1, 71));
    let mut world = unit(1, 90);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(11);
    let mut rig = Rig::new(config, &mut world);
    rig.align().unwrap();
    let mut passed_s = 0.0;
    let mut worst = 0.0f64;
    let mut hours = [(Vector3::<f64>::zeros(), 0.0); 2];
    while passed_s < 7200.0 {
        // from interruptions of the previous move to long holds
        let hold_s = [0.05, 0.4, 1.5, 6.0][rng.random_range(0..4)];
        let bend = Bend::from_deg(rng.random_range(0.0..80.0), rng.random_range(-180.0..180.0));
        hold(&mut rig, bend, hold_s);
        passed_s += hold_s;
        let now = rig.state.lines().map(|l| l.k_epsilon);
        if passed_s > 600.0 {
            worst = (0..3)
                .map(|i| (now[i] / truth[i] - 1.0).abs())
                .fold(worst, f64::max);
        }
        let hour = &mut hours[usize::from(passed_s >= 3600.0)];
        *hour = (hour.0 + Vector3::from(now) * hold_s, hour.1 + hold_s);
    }
    let [first, second] = hours.map(|(sum, time)| sum / time);
    let drift = (0..3)
        .map(|i| (second[i] / first[i] - 1.0).abs())
        .fold(0.0, f64::max);
    println!(
        "largest error of k_ε after ten minutes {:.0} %, second hour against first {:.1} %",
        100.0 * worst,
        100.0 * drift
    );
    assert!(worst < 0.2, "{:?}", rig.state.lines());
    assert!(drift < 0.05, "{first:?} then {second:?}");
    let mut command = Some(Shape {
        bend: Bend(Vector2::new(0.8, 0.3)),
        length: Mm(rig.config.geometry.rest_length_mm),
    });
    let mut error_deg = f64::INFINITY;
    for _ in 0..(3.0 / rig.period_s()) as usize {
        let (_, reply) = rig.advance(command.take()).unwrap();
        error_deg =
            (Bend::from_rotation(&reply.truth.unwrap()).beta() - 0.8f64.hypot(0.3)).to_degrees();
    }
    println!(
        "after two hours: bend error {error_deg:.2}°, k_ε {:?}",
        rig.state.lines()
    );
    assert!(error_deg.abs() < 1.0);
}

#[test]
fn the_loop_takes_step_and_rest_length_from_the_world() {
    let world = unit(1, 0);
    let config = for_world(&uncalibrated(), &world);
    assert_eq!(config.drive.step_mm, world.info().step_mm);
    assert_eq!(config.geometry.rest_length_mm, world.info().rest_length_mm);
}
