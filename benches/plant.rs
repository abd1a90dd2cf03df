//! Time per step of the plant at 1 kHz, in motion.

#![allow(clippy::expect_used)]

use retroflex::config::board::Board;
use retroflex::config::source;
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::{Plant, PlantConfig, effect_names};
use std::hint::black_box;

fn main() {
    divan::main();
}

/// Steps per iteration: one second.
const STEPS: usize = 1000;

/// One second of a plant whose pistons oscillate.
fn one_second(bencher: divan::Bencher<'_, '_>, config: &PlantConfig) {
    let mut plant = Plant::new(config, 1).expect("the configurations of this bench are valid");
    let mut k = 0i32;
    bencher
        .counter(divan::counter::ItemsCount::new(STEPS))
        .bench_local(move || {
            for _ in 0..STEPS {
                k += 1;
                let n = if k % 2000 < 1000 {
                    k % 1000
                } else {
                    1000 - k % 1000
                } / 2;
                black_box(plant.step(&Steps([n, -n, n / 2]), 0.001));
            }
        });
}

#[divan::bench]
fn nominal(bencher: divan::Bencher<'_, '_>) {
    one_second(bencher, &PlantConfig::default());
}

#[divan::bench]
fn paper_twin(bencher: divan::Bencher<'_, '_>) {
    let board: Board = source::parse("boards/sim.toml", include_str!("../boards/sim.toml"))
        .expect("the twin's file is valid");
    one_second(bencher, &board.plant.expect("the twin has a plant"));
}

#[divan::bench]
fn everything_at_once(bencher: divan::Bencher<'_, '_>) {
    let mut rng = <rand::rngs::Xoshiro256PlusPlus as rand::SeedableRng>::seed_from_u64(1);
    let config = effect_names().fold(PlantConfig::default(), |c, e| {
        c.with_effect(e.name, 0.3, &mut rng)
            .expect("listed names are known")
    });
    one_second(bencher, &config);
}
