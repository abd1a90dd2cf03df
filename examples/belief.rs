//! Draws what the loop believes about the tip beside what is true: `cargo run --release --example belief > docs/belief.svg`.
//!
//! The paper twin, whose lines are not those of the paper's calibration, makes its first moves out and back. Drawn are the true bend
//! angle, its estimate, and the angle at which the observer believes the tip will have settled, with a band of two standard
//! deviations: wide at first, and narrow where the laws have been learned.
#![allow(
    clippy::expect_used,
    reason = "a tool that may stop at the first error"
)]

use retroflex::config::{Board, Calibration, Gains, assemble, source};
use retroflex::experiment::evaluation::{Arm, for_world};
use retroflex::experiment::rig::Rig;
use retroflex::experiment::schedule::arrivals;
use retroflex::model::{Bend, Shape};
use retroflex::primitives::Mm;
use retroflex::report::chart::{Axis, Chart, Series, Stroke};
use retroflex::report::svg::Ink;
use retroflex::simulation::sim::Sim;

/// Duration of a pose, s, and the poses that are drawn.
const HOLD_S: f64 = 1.0;
const POSES: usize = 11;

fn main() {
    let board: Board = source::parse("boards/sim.toml", include_str!("../boards/sim.toml"))
        .expect("a shipped board is valid");
    let calib: Calibration = source::parse("calib/paper.toml", include_str!("../calib/paper.toml"))
        .expect("a shipped calibration is valid");
    let plant = board.plant.clone().expect("the board has a plant");
    let config = assemble(&board, &calib, &Gains::default());
    let mut world = Sim::new(&plant, 1, 3, plant.period_s).expect("the unit is valid");
    let mut rig = Rig::new(Arm::Closed.config(&for_world(&config, &world)), &mut world);
    rig.align().expect("the tip is still");
    let (mut truth, mut estimate, mut believed, mut band) = (vec![], vec![], vec![], vec![]);
    let ticks = (HOLD_S / rig.period_s()).round() as usize;
    let every = (0.02 / rig.period_s()).round() as usize;
    for (n, pose) in arrivals(1).iter().take(POSES).enumerate() {
        let mut command = Some(Shape {
            bend: pose.bend(),
            length: Mm(rig.config.geometry.rest_length_mm),
        });
        for k in 0..ticks {
            let (frame, sensed) = rig.advance(command.take()).expect("the world runs");
            if k % every != 0 {
                continue;
            }
            let t = n as f64 * HOLD_S + k as f64 * rig.period_s();
            let deg = |bend: &Bend| bend.beta().to_degrees();
            truth.push((t, sensed.truth.map_or(0.0, |r| deg(&Bend::nearest(&r)))));
            estimate.push((t, frame.estimate.map_or(0.0, |e| deg(&e.bend))));
            let (settled, sigma) = (
                frame.belief.settled.norm().to_degrees(),
                frame.belief.sigma_rad.to_degrees(),
            );
            believed.push((t, settled));
            band.push((t, settled - 2.0 * sigma, settled + 2.0 * sigma));
        }
    }
    let ends = [0.0, 90.0];
    let chart = Chart::new(
        "Bend of the tip and the belief about it (band: 2 σ)",
        Axis::new("time, s", 0.0, POSES as f64 * HOLD_S, 6),
        Axis::new("bend angle, °", ends[0], ends[1], 6),
        vec![
            Series::band(
                Ink::ORANGE,
                band.iter()
                    .map(|&(t, low, high)| (t, low.max(ends[0]), high.min(ends[1])))
                    .collect(),
            ),
            Series::line(
                "believed once settled",
                Ink::ORANGE,
                Stroke::Solid,
                believed,
            ),
            Series::line("estimated", Ink::BLUE, Stroke::Solid, estimate),
            Series::line("true", Ink::GREEN, Stroke::Dashed, truth),
        ],
    );
    print!("{}", chart.svg());
}
