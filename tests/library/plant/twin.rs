//! The paper twin reproduces the paper's open-loop figures.

use super::open_loop::{Arm, arm, identify, rmse};
use retroflex::config::board::Board;
use retroflex::config::source;
use retroflex::simulation::plant::PlantConfig;

/// The paper's RMSE of the bend angle, degrees: none, extension, extension + backlash.
const PAPER_DEG: [f64; 3] = [36.96, 8.04, 7.76];

/// The twin of `boards/sim.toml`.
pub fn paper_twin() -> PlantConfig {
    let board: Board =
        source::parse("boards/sim.toml", include_str!("../../../boards/sim.toml")).unwrap();
    board.plant.unwrap()
}

fn arms(config: &PlantConfig, seed: u64) -> ([f64; 3], [f64; 6], usize) {
    let (lines, passes) = identify(config, seed);
    let rmse = [Arm::None, Arm::Extension, Arm::Backlash]
        .map(|a| rmse(&arm(config, seed + 1000, &lines, a)));
    let k = std::array::from_fn(|i| {
        if i < 3 {
            lines[i].k_epsilon
        } else {
            lines[i - 3].k_lambda_mm
        }
    });
    (rmse, k, passes)
}

#[test]
fn three_arms_match_the_paper_within_ten_percent() {
    let (rmse, k, passes) = arms(&paper_twin(), 1);
    println!("rmse {rmse:.2?}  k* {k:.2?}  passes {passes}");
    for (got, want) in rmse.iter().zip(PAPER_DEG) {
        assert!((got / want - 1.0).abs() < 0.10, "{rmse:?}");
    }
    assert!(passes <= 7, "the paper converged within 7, here {passes}");
    assert!(
        rmse[1] > rmse[2],
        "backlash compensation reduces the error slightly"
    );
}

#[test]
fn units_spread_around_the_paper() {
    let units: Vec<_> = (1..=20)
        .map(|seed| arms(&paper_twin().drawn(seed), seed))
        .collect();
    for (a, paper) in PAPER_DEG.iter().enumerate() {
        let all: Vec<f64> = units.iter().map(|u| u.0[a]).collect();
        let (low, high) = all
            .iter()
            .fold((f64::MAX, 0.0f64), |(l, h), &x| (l.min(x), h.max(x)));
        let mean = all.iter().sum::<f64>() / 20.0;
        println!("arm {a}: {low:.2} to {high:.2}, mean {mean:.2} deg (paper {paper:.2})");
        assert!((mean / paper - 1.0).abs() < 0.15 && high / low < 2.2);
    }
    assert!(
        units.iter().filter(|u| u.2 < 12).count() >= 18,
        "Algorithm 1 converges on nearly every unit"
    );
}
