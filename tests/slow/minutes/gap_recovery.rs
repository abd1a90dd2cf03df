//! Recovery of every catalogue effect from one log of the built-in plant.
//!
//! Each effect is injected alone into a unit of its own, at a size drawn from its typical range, and recorded on a random
//! schedule with a calibration that is a few percent off. Logs alternate between lab (with tracker) and field.

use rand::SeedableRng;
use rand::rngs::StdRng;
use rayon::prelude::*;
use retroflex::diagnosis::diagnose;
use retroflex::diagnosis::tip::observed::Observed;
use retroflex::diagnosis::tip::{Diagnosis, Rig, TipProblem};
use retroflex::experiment::exam::{Content, PERIOD_S, Question, record};
use retroflex::log::bend_log::BendLog;
use retroflex::model::Line;
use retroflex::model::effects::catalogue;
use retroflex::simulation::plant::PlantConfig;
use retroflex::simulation::sim::Sim;

/// First seed; effect `n` has seed `SEED + n`.
const SEED: u64 = 4000;

/// Effects that are not recovered, with the measured reason.
const UNRECOVERED: [(&str, &str); 1] = [(
    "softening",
    "verdict unknown with softening as a part: it closes 88 %, and the rest is taken for another cause instead of another form",
)];

/// Least probability of a recovered effect.
const PROBABLE: f64 = 0.5;

fn diagnosis_of(name: &'static str, n: usize) -> Diagnosis {
    let question = Question {
        content: Content::Single,
        names: vec![name],
        lab: n.is_multiple_of(2),
        seed: SEED + n as u64,
    };
    let logs = question.draw().unwrap();
    let log = Observed::new(&logs.log, &Rig::default()).unwrap();
    diagnose(&TipProblem::new(&log, catalogue(), &logs.lines, 1)).document
}

/// Whether the most probable effect is more likely than not, and is `name` or belongs to a stated group with it.
fn is_recovered(d: &Diagnosis, name: &str) -> bool {
    let top = &d.effects[0];
    let group = d.verdict.equivalent.iter().find(|g| g.contains(&name));
    let named = top.name == name || group.is_some_and(|g| g.contains(&top.name));
    // effects that the log cannot tell apart share their probability
    let of_group = d
        .effects
        .iter()
        .filter(|e| group.is_some_and(|g| g.contains(&e.name)));
    let shared = of_group.map(|e| e.probability).sum::<f64>();
    named && shared.max(top.probability) > PROBABLE
}

#[test]
fn every_effect_is_recovered_from_one_log() {
    let names: Vec<&'static str> = catalogue().iter().map(|e| e.name()).collect();
    let all: Vec<Diagnosis> = names
        .par_iter()
        .enumerate()
        .map(|(n, name)| diagnosis_of(name, n))
        .collect();
    for (n, (name, d)) in names.iter().zip(&all).enumerate() {
        let (rig, e) = (if n % 2 == 0 { "lab" } else { "field" }, &d.effects[0]);
        let own = d.effects.iter().find(|e| e.name == *name).unwrap();
        println!(
            "{name:20} {rig:5}: {} with {:.2}, closes {:.2}; itself {:.2}, closes {:.2}; verdict {:?} {:?}; gap {:.2}°",
            e.name,
            e.probability,
            e.closed,
            own.probability,
            own.closed,
            d.verdict.kind,
            d.verdict.names,
            d.gap.recalibrated_deg
        );
    }
    let failed: Vec<&str> = names
        .iter()
        .zip(&all)
        .filter(|(name, d)| !is_recovered(d, name))
        .map(|(name, _)| *name)
        .collect();
    assert_eq!(
        failed,
        UNRECOVERED.map(|u| u.0),
        "the list of unrecovered effects is out of date"
    );
}

/// A unit in a hand: its base turns by 20° and sways by 5°, and one effect is added. The IMU on the base explains the motion of the base, so the
/// added effect is found.
#[test]
fn an_imu_on_the_base_explains_the_motion_of_the_base() {
    let lines = [Line {
        k_epsilon: 0.1,
        k_lambda_mm: 0.35,
    }; 3];
    for (n, name) in ["cable_stiffness", "gyro_bias", "leak", "line_lag"]
        .into_iter()
        .enumerate()
    {
        let mut rng = StdRng::seed_from_u64(SEED + n as u64);
        let mut plant = PlantConfig::default();
        (plant.base.imu, plant.imu.period_s) = (true, 0.01);
        // a smaller gyro_bias lowers the error of the gyroscope by less than is claimed
        let mut plant = plant
            .with_effect("base_motion", 0.5, &mut rng)
            .unwrap()
            .with_effect(name, 0.8, &mut rng)
            .unwrap();
        let motion = plant.effects.base_motion.as_mut().unwrap();
        (motion.angle_deg, motion.sway_deg, motion.sway_period_s) = (20.0, 5.0, 6.0);
        let mut log = record(
            |noise| Ok(Sim::new(&plant, 0, noise, PERIOD_S)?),
            &lines,
            SEED,
            false,
        )
        .unwrap();
        let verdict = |log: &BendLog| {
            let log = Observed::new(log, &Rig::default()).unwrap();
            diagnose(&TipProblem::new(&log, catalogue(), &lines, 1))
                .document
                .verdict
        };
        let with = verdict(&log);
        log.base = None;
        let without = verdict(&log);
        println!("{name}: with {:?}, without {:?}", with.names, without.names);
        assert_eq!(with.names, [name]);
        assert_ne!(without.names, [name]);
    }
}
