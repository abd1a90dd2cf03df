//! The closed loop on `tests/independent_plant/plant.c`, a plant in another language that shares no equation with this program.
//!
//! Two calibrations, both with nothing but `[transmission]`, so that the loop starts without the dynamics of the plant: *paper*,
//! the gains that the paper reports, which are wrong by up to a quarter on these units; and *own*, the gains of the unit.
#![allow(dead_code, reason = "every test binary takes its own part of this")]

use crate::common::{repo, twin};
use rayon::prelude::*;
use retroflex::config::assemble;
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::diagnosis::tip::Rig;
use retroflex::experiment::arm::ArmResult;
use retroflex::experiment::evaluation::{Arm, Evaluation, Plan, run};
use retroflex::simulation::link::Link;
use retroflex::simulation::world::World;
use std::path::Path;
use std::process::Command;

/// Gains that the loop starts with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cold {
    Paper,
    Own,
}

/// One run: an effect with its size, drawn by the plant unless given.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    pub effect: &'static str,
    pub value: Option<f64>,
    pub seed: u64,
    pub cold: Cold,
}

/// Bend RMSE of extension with backlash and of the closed loop, what a held state moves more in the latter, peak to peak, and the
/// number of states that do not settle; degrees.
#[derive(Debug, Clone, Copy)]
pub struct Figures {
    pub open: f64,
    pub closed: f64,
    pub hunting: f64,
    pub unsettled: usize,
}

/// The compiled plant in a folder of its own; `None`, with the reason printed, without a C compiler.
pub fn compiled() -> Option<tempfile::TempDir> {
    let folder = tempfile::tempdir().unwrap();
    let source = repo("tests/independent_plant/plant.c");
    match Command::new("cc")
        .args(["-O2", "-o"])
        .arg(folder.path().join("plant"))
        .arg(source)
        .arg("-lm")
        .output()
    {
        Err(why) => println!("skipped: there is no C compiler `cc` ({why})"),
        Ok(out) if out.status.success() => return Some(folder),
        Ok(out) => panic!(
            "plant.c does not compile: {}",
            String::from_utf8_lossy(&out.stderr)
        ),
    }
    None
}

pub fn calibration(plant: &Path, case: &Case) -> Calibration {
    if case.cold == Cold::Paper {
        let paper: Calibration = source::read(&repo("calib/paper.toml")).unwrap();
        return Calibration {
            transmission: paper.transmission,
            ..Calibration::default()
        };
    }
    let out = Command::new(plant)
        .args(arguments(case))
        .arg("--calib")
        .output()
        .unwrap();
    source::parse("plant --calib", &String::from_utf8(out.stdout).unwrap()).unwrap()
}

pub fn arguments(case: &Case) -> Vec<String> {
    let value = case.value.map(|v| ["--value".to_owned(), v.to_string()]);
    let known = ["--effect", case.effect, "--seed"].map(str::to_owned);
    known
        .into_iter()
        .chain([case.seed.to_string()])
        .chain(value.into_iter().flatten())
        .collect()
}

/// Some arms of the experiment on a case; `more` are further arguments of the plant.
pub fn evaluated(
    folder: &tempfile::TempDir,
    case: &Case,
    arms: &[Arm],
    more: &[&str],
) -> Evaluation {
    let plant = folder.path().join("plant");
    let config = assemble(&twin(), &calibration(&plant, case), &Gains::default());
    let rig = Rig::default();
    let plan = Plan {
        config,
        identify: false,
        arms: arms.to_vec(),
        seed: case.seed,
        rig,
        track: None,
        feedforward: None,
    };
    let mut arguments = arguments(case);
    arguments.extend(more.iter().map(|a| (*a).to_owned()));
    let mut open =
        |_| Ok(Box::new(Link::start(plant.to_str().unwrap(), &arguments)?) as Box<dyn World>);
    run(&plan, &mut open, &mut |_| ()).unwrap()
}

pub fn measure(folder: &tempfile::TempDir, case: &Case) -> Figures {
    let e = evaluated(folder, case, &[Arm::Backlash, Arm::Closed], &[]);
    let (open, closed): (&ArmResult, &ArmResult) =
        (e.arm(Arm::Backlash).unwrap(), e.arm(Arm::Closed).unwrap());
    let more = closed
        .held
        .iter()
        .zip(&open.held)
        .map(|(c, o)| c.peak_to_peak_deg - o.peak_to_peak_deg);
    Figures {
        open: open.bend_rmse_deg,
        closed: closed.bend_rmse_deg,
        hunting: more.fold(0.0, f64::max),
        unsettled: closed.unsettled,
    }
}

/// All cases on two threads, each printed as it ends.
pub fn measure_all(folder: &tempfile::TempDir, cases: &[Case]) -> Vec<(Case, Figures)> {
    println!(
        "{:<20} {:>7} {:>4} {:>6} {:>7} {:>7} {:>8} {:>5}",
        "effect", "value", "seed", "gains", "open", "closed", "hunting", "never"
    );
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(2)
        .build()
        .unwrap();
    let one = |case: &Case| {
        let f = measure(folder, case);
        println!(
            "{:<20} {:>7} {:>4} {:>6} {:>6.2}° {:>6.2}° {:>7.2}° {:>5}",
            case.effect,
            case.value.map_or("drawn".to_owned(), |v| v.to_string()),
            case.seed,
            format!("{:?}", case.cold),
            f.open,
            f.closed,
            f.hunting,
            f.unsettled
        );
        (*case, f)
    };
    pool.install(|| cases.par_iter().map(one).collect())
}

pub const HUNTING_MAX_DEG: f64 = 0.5;

pub fn helps(f: &Figures) -> bool {
    f.closed <= f64::max(0.3, 0.5 * f.open)
}

pub fn harms(f: &Figures) -> bool {
    f.closed > f64::max(0.3, f.open) || f.hunting > HUNTING_MAX_DEG
}

/// The rows of `measured` that satisfy a condition.
pub fn rows(measured: &[(Case, Figures)], which: fn(&Figures) -> bool) -> Vec<&(Case, Figures)> {
    measured.iter().filter(|(_, f)| which(f)).collect()
}

/// A number from the environment.
pub fn variable(name: &str, default: u64) -> u64 {
    std::env::var(name)
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(default)
}
