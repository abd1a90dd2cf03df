//! What the tests share: the paper twin as a world, and the loop for it.
#![allow(dead_code, reason = "every test binary takes its own part of this")]

pub mod flight;

use retroflex::config::assemble;
use retroflex::config::board::{Board, PlantSection};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::{source, supervisor};
use retroflex::control::learning::identify::Identified;
use retroflex::control::tick::LoopConfig;
use retroflex::diagnosis::tip::Rig;
use retroflex::drill::bench::BenchConfig;
use retroflex::experiment::evaluation::{self, Arm, Evaluation, Plan, Purpose, for_world};
use retroflex::experiment::identify::algorithm_1;
use retroflex::experiment::schedule::paper;
use retroflex::model::arc::Geometry;
use retroflex::model::described::{DescribedMachine, RestReadings};
use retroflex::model::effects::by_name;
use retroflex::model::nominal_theta;
use retroflex::model::transmission::Line;
use retroflex::simulation::sim::Sim;
use retroflex::simulation::world::World;
use std::path::{Path, PathBuf};

/// A bench for the drills on the plant of a board.
pub fn bench(board: &Board, calibration: &Calibration, gains: &Gains) -> BenchConfig {
    let plant = board.plant.clone().unwrap_or_default();
    let sim = Sim::new(&plant, 0, 0, plant.period_s).unwrap();
    let supervisor = supervisor::assemble(board, calibration, gains, sim.info());
    BenchConfig { plant, supervisor }
}

/// The paper twin with the paper's calibration, as a bench for the drills.
pub fn paper_bench() -> BenchConfig {
    let calibration = source::read(&repo("calib/paper.toml")).unwrap();
    bench(&twin(), &calibration, &Gains::default())
}

/// A file of the repository.
pub fn repo(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// What a command printed as one line, without the lines of the file that an error quotes.
pub fn flat(text: &str) -> String {
    let is_quoted = |line: &&str| {
        let head = line.split('|').next().unwrap_or_default().trim();
        line.contains('|') && head.parse::<u32>().map_or(head.is_empty(), |_| true)
    };
    let lines = text.lines().filter(|line| !is_quoted(line));
    let words: Vec<&str> = lines.flat_map(str::split_whitespace).collect();
    words.join(" ")
}

/// How often a test that draws kills or attacks repeats them; `RETROFLEX_TRIES` sets it.
pub fn tries() -> u32 {
    let set = std::env::var("RETROFLEX_TRIES").ok();
    set.map_or(1, |n| n.parse().unwrap())
}

/// The board that `evaluate` uses when none is named.
pub fn twin() -> Board {
    source::read(&repo("boards/sim.toml")).unwrap()
}

/// Its plant.
pub fn plant() -> PlantSection {
    twin().plant.unwrap()
}

/// The loop with nothing calibrated.
pub fn uncalibrated() -> LoopConfig {
    assemble(&twin(), &Calibration::default(), &Gains::default())
}

/// Unit `seed` of the twin, with noise of its own for every `noise`.
pub fn unit(seed: u64, noise: u64) -> Sim {
    let plant = plant();
    Sim::new(&plant, seed, noise, plant.period_s).unwrap()
}

/// Unit `seed` of a tip that follows Eq. 16 and has none of the twin's effects.
pub fn plain(seed: u64, noise: u64) -> Sim {
    let plant = plant();
    let make = retroflex::simulation::plant::config::PlantConfig {
        effects: retroflex::simulation::plant::effects::Effects::default(),
        ..plant.clone()
    };
    Sim::new(&make, seed, noise, plant.period_s).unwrap()
}

/// Identification and arms on unit `seed`, as the command does it.
pub fn evaluate(seed: u64, arms: &[Arm]) -> Evaluation {
    let plan = Plan {
        config: uncalibrated(),
        identify: true,
        arms: arms.to_vec(),
        seed,
        rig: Rig::default(),
        track: None,
        feedforward: None,
    };
    let mut open = |purpose: Purpose| {
        let noise = match purpose {
            Purpose::Identify => 0,
            Purpose::Arm(arm) => 1 + arm as u64,
            Purpose::Record => 1 + Arm::ALL.len() as u64,
            Purpose::Track => 2 + Arm::ALL.len() as u64,
        };
        Ok(Box::new(unit(seed, noise)) as Box<dyn World>)
    };
    evaluation::run(&plan, &mut open, &mut |_| ()).unwrap()
}

/// A machine as a diagnosis describes it, with laws of every stage that a feedforward inverts.
pub fn described() -> DescribedMachine {
    let lines = [2.0, 2.4, 1.9].map(|k_epsilon| Line {
        k_epsilon,
        k_lambda_mm: 0.7,
    });
    let causes: [(&str, &[f64]); 6] = [
        (
            "gear_periodic",
            &[0.05, -0.05, 0.04, 0.02, 0.03, -0.02, 3.2],
        ),
        ("leak", &[0.004, 0.002, 0.003, 1.0]),
        ("line_lag", &[0.15, 0.2, 0.18, 0.1, 0.05]),
        ("hysteresis", &[0.1, 0.1, 0.1, 0.1, 0.0, 0.1, -0.1]),
        ("creep", &[0.06, 0.08, 2.0]),
        ("gravity", &[0.06, 0.8]),
    ];
    let causes = causes
        .iter()
        .map(|(name, p)| (by_name(name).unwrap(), p.to_vec()))
        .collect();
    DescribedMachine::new(
        Geometry::default(),
        RestReadings::default(),
        &nominal_theta(&lines, 0.025),
        causes,
    )
}

/// The loop with the gains that Algorithm 1 finds on unit `seed` of the twin.
pub fn identified(seed: u64) -> (LoopConfig, Identified) {
    let mut world = unit(seed, 0);
    let config = for_world(&uncalibrated(), &world);
    let found = algorithm_1(&config, &mut world, &paper(), None, &mut |_| ()).unwrap();
    (
        LoopConfig {
            lines: found.lines(),
            dynamics: found.dynamics,
            ..config
        },
        found,
    )
}
