//! Duration of a tick, and simulated seconds per second: `cargo bench --bench tick`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a failed set-up ends the benchmark"
)]

#[path = "../tests/common/mod.rs"]
mod common;

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use retroflex::config::assemble;
use retroflex::config::board::{Board, PlantSection};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::control::tick::{Frame, Input, LoopConfig, LoopState, tick};
use retroflex::experiment::arm;
use retroflex::experiment::evaluation::for_world;
use retroflex::experiment::rig::Rig;
use retroflex::experiment::schedule::{HOLD_S, paper};
use retroflex::model::Shape;
use retroflex::motion::machine::Machine;
use retroflex::primitives::units::{Mm, Seconds, Steps};
use retroflex::service::rt_loop::LoopFrame;
use retroflex::simulation::lockstep::Lockstep;
use retroflex::simulation::sim::Sim;
use retroflex::simulation::world::World;
use rtrb::RingBuffer;
use std::sync::Arc;

fn main() {
    divan::main();
}

fn plant() -> PlantSection {
    let board: Board =
        source::parse("boards/sim.toml", include_str!("../boards/sim.toml")).unwrap();
    board.plant.unwrap()
}

fn sim() -> Sim {
    let plant = plant();
    Sim::new(&plant, 1, 1, plant.period_s).unwrap()
}

fn config() -> LoopConfig {
    let board: Board =
        source::parse("boards/sim.toml", include_str!("../boards/sim.toml")).unwrap();
    let calib: Calibration =
        source::parse("calib/paper.toml", include_str!("../calib/paper.toml")).unwrap();
    for_world(&assemble(&board, &calib, &Gains::default()), &sim())
}

/// Inputs of the loop during one minute of the experiment.
fn inputs(config: &LoopConfig) -> Vec<Input> {
    let (mut machine, mut state) = (Lockstep::new(sim(), &config.motion), LoopState::new(config));
    machine.energise(true);
    let mut input = Input {
        dt_s: machine.info().period_s,
        ..Input::default()
    };
    let mut poses = paper().into_iter().cycle();
    let mut all = Vec::new();
    for k in 0..60_000 {
        if k >= 3000 && k % 1500 == 0 {
            input.command = poses.next().map(|p| Shape {
                bend: p.bend(),
                length: Mm(config.geometry.rest_length_mm),
            });
        }
        all.push(input);
        let frame = tick(config, &mut state, &input);
        let t = Seconds(f64::from(k + 1) * input.dt_s);
        let sensed = machine.turn(t, &frame.steps).unwrap();
        input = Input {
            t,
            imu: sensed.imu,
            steps: sensed.counted,
            command: None,
            ..input
        };
    }
    all
}

/// From fusion to steps, averaged over one minute of the experiment; one item is one tick.
#[divan::bench(sample_count = 20)]
fn one_tick(bencher: Bencher<'_, '_>) {
    let config = config();
    let inputs = inputs(&config);
    bencher
        .counter(ItemsCount::new(inputs.len()))
        .bench_local(|| {
            let mut state = LoopState::new(&config);
            let mut last: Option<Frame> = None;
            for input in &inputs {
                last = Some(tick(&config, &mut state, black_box(input)));
            }
            last
        });
}

/// The same through the inverse of a described machine with laws that remember; one item is one tick.
#[divan::bench(sample_count = 20)]
fn one_tick_fed_forward(bencher: Bencher<'_, '_>) {
    let config = config();
    let inputs = inputs(&config);
    let config = LoopConfig {
        feedback: None,
        ..config
    }
    .fed_forward(Arc::new(common::described()));
    bencher
        .counter(ItemsCount::new(inputs.len()))
        .bench_local(|| {
            let mut state = LoopState::new(&config);
            let mut last: Option<Frame> = None;
            for input in &inputs {
                last = Some(tick(&config, &mut state, black_box(input)));
            }
            last
        });
}

/// What the flight log, the status and the subscribers cost the loop: the ring that takes each cycle to their threads. One item
/// is one cycle.
#[divan::bench(sample_count = 200)]
fn handing_over_a_cycle(bencher: Bencher<'_, '_>) {
    const CYCLES: usize = 4000;
    let (calibration, gains) = (Calibration::default(), Gains::default());
    let config = common::bench(&common::twin(), &calibration, &gains);
    let mut bench = config.bench(1, 1).unwrap();
    let output = bench.turn(None).unwrap();
    let frame = LoopFrame {
        number: 0,
        restart: bench.runner.supervisor.keep(),
        at_rest: true,
        lost: false,
        idle: false,
        changes: 0,
        output,
    };
    let (mut ring, mut hub) = RingBuffer::<LoopFrame>::new(CYCLES);
    // the hub has emptied the ring, as it does every few milliseconds
    let emptied = || while hub.pop().is_ok() {};
    bencher
        .counter(ItemsCount::new(CYCLES))
        .with_inputs(emptied)
        .bench_local_values(|()| {
            for number in 0..CYCLES as u64 {
                ring.push(black_box(LoopFrame { number, ..frame })).unwrap();
            }
        });
}

/// The closed arm of `evaluate` on the paper twin at 1 kHz; one item is one simulated second.
#[divan::bench(sample_count = 5)]
fn closed_arm(bencher: Bencher<'_, '_>) {
    let config = config();
    let seconds = (paper().len() as f64 * HOLD_S) as usize;
    bencher.counter(ItemsCount::new(seconds)).bench_local(|| {
        let mut world = sim();
        arm::run(
            "closed",
            &mut Rig::new(config.clone(), &mut world),
            &paper(),
            &mut || (),
        )
        .unwrap()
        .bend_rmse_deg
    });
}

/// The plant alone; one item is one simulated second.
#[divan::bench(sample_count = 5)]
fn plant_alone(bencher: Bencher<'_, '_>) {
    bencher.counter(ItemsCount::new(20usize)).bench_local(|| {
        let mut world = sim();
        (0..20_000).fold(0.0, |sum, k| {
            sum + f64::from(
                world
                    .step(&Steps([k / 50, -k / 50, 0]))
                    .unwrap()
                    .imu
                    .is_some(),
            )
        })
    });
}
