//! The loop and the diagnosis on a plant in C that shares no code with the library.

use crate::plant_in_c::{
    Case, Cold, compiled, evaluated, harms, helps, measure_all, rows, variable,
};
use rand::rngs::StdRng;
use rand::{Rng, RngExt, SeedableRng};
use retroflex::config::calib::Calibration;
use retroflex::config::source;
use retroflex::diagnosis::exam::run::run as answer_all;
use retroflex::diagnosis::exam::{
    Content, Logs, Question, Recorded, Row, questions, record, score,
};
use retroflex::experiment::evaluation::Arm;
use retroflex::model::Line;
use retroflex::model::effects::catalogue;
use retroflex::report::exam::summary;
use retroflex::simulation::link::Link;
use retroflex::supervisor::MachineError;
use std::process::Command;

/// The effects of the catalogue. A base that moves without an IMU of its own cannot be told from a tip that moves, and is left out.
const EFFECTS: [&str; 25] = [
    "missed_steps",
    "gear_periodic",
    "leak",
    "gas_compression",
    "line_lag",
    "thermal_drift",
    "crosstalk",
    "stiffening",
    "asymmetry",
    "hysteresis",
    "creep",
    "softening",
    "gravity",
    "curvature",
    "clocking",
    "cable_stiffness",
    "torsion",
    "contact",
    "gyro_bias",
    "accel_bias",
    "hard_iron",
    "motor_field",
    "mount_misalignment",
    "transport_delay",
    "sensor_latency",
];

#[test]
fn the_loop_helps_with_every_effect_and_never_harms() {
    let Some(folder) = compiled() else { return };
    let units = || (1..=3).flat_map(|seed| [(seed, Cold::Paper), (seed, Cold::Own)]);
    let cases: Vec<Case> = EFFECTS
        .iter()
        .flat_map(|effect| {
            units().map(move |(seed, cold)| Case {
                effect,
                value: None,
                seed,
                cold,
            })
        })
        .collect();
    let measured = measure_all(&folder, &cases);
    // a goal behind a wall cannot be reached
    let reachable: Vec<_> = measured
        .iter()
        .filter(|(c, _)| c.effect != "contact")
        .copied()
        .collect();
    let helped = rows(&reachable, helps).len();
    let harmed = rows(&measured, harms);
    println!(
        "helps on {helped} of {}; harms on {}: {harmed:#?}",
        reachable.len(),
        harmed.len()
    );
    assert!(harmed.is_empty() && 20 * helped >= 19 * reachable.len());
}

/// Effect, sizes, and the largest bend RMSE in degrees.
const ROWS: [(&str, &[f64], f64); 9] = [
    ("transport_delay", &[0.12, 0.18, 0.25], 0.5),
    ("sensor_latency", &[0.12, 0.18, 0.25], 0.5),
    ("line_lag", &[0.25, 0.4, 0.6], 0.6),
    ("stick_slip", &[1.6, 2.1, 2.6], 2.5),
    ("respiration", &[3.0, 4.0, 5.0], 0.8),
    ("pinch", &[10.0, 25.0, 40.0], 0.3),
    ("motor_field", &[0.3, 1.0, 3.0, 6.0], 0.3),
    ("soft_wall", &[0.5, 0.75, 1.0], f64::INFINITY),
    ("wall_release", &[0.5, 0.75, 1.0], f64::INFINITY),
];

#[test]
fn the_loop_withstands_delays_friction_breath_and_walls() {
    let Some(folder) = compiled() else { return };
    let units = || (1..=3).flat_map(|seed| [(seed, Cold::Paper), (seed, Cold::Own)]);
    let sizes = ROWS
        .iter()
        .flat_map(|&(effect, values, _)| values.iter().map(move |&v| (effect, v)));
    let cases: Vec<Case> = sizes
        .flat_map(|(effect, v)| {
            units().map(move |(seed, cold)| Case {
                effect,
                value: Some(v),
                seed,
                cold,
            })
        })
        .collect();
    let measured = measure_all(&folder, &cases);
    let most = |effect: &str| ROWS.iter().find(|r| r.0 == effect).unwrap().2;
    let beyond: Vec<_> = measured
        .iter()
        .filter(|(c, f)| f.closed > most(c.effect))
        .collect();
    let harmed = rows(&measured, harms);
    println!(
        "beyond the bound on {} of {}; harms on {}",
        beyond.len(),
        measured.len(),
        harmed.len()
    );
    assert!(
        beyond.is_empty() && harmed.is_empty(),
        "{beyond:#?} {harmed:#?}"
    );
}

/// Effects on the way from the command to the shape, without those that happen once.
const MECHANICAL: [&str; 15] = [
    "gear_periodic",
    "leak",
    "gas_compression",
    "line_lag",
    "thermal_drift",
    "crosstalk",
    "stiffening",
    "asymmetry",
    "hysteresis",
    "creep",
    "softening",
    "gravity",
    "curvature",
    "clocking",
    "cable_stiffness",
];

/// Bend RMSE of extension with backlash and of the open loop through the diagnosed model, degrees.
fn diagnosed(folder: &tempfile::TempDir, case: &Case) -> [f64; 2] {
    let arms = [Arm::Backlash, Arm::Diagnosed];
    let e = evaluated(folder, case, &arms, &[]);
    arms.map(|arm| e.arm(arm).unwrap().bend_rmse_deg)
}

#[test]
fn the_diagnosed_model_closes_most_of_the_gap_of_the_open_loop() {
    let Some(folder) = compiled() else { return };
    let mut ratios = Vec::new();
    for effect in MECHANICAL {
        for seed in 1..=2 {
            let [backlash, diagnosed] = diagnosed(
                &folder,
                &Case {
                    effect,
                    value: None,
                    seed,
                    cold: Cold::Paper,
                },
            );
            println!(
                "{effect:<20} {seed} {backlash:>6.2}° {diagnosed:>6.2}° {:>5.2}",
                diagnosed / backlash
            );
            ratios.push(diagnosed / backlash);
        }
    }
    ratios.sort_by(f64::total_cmp);
    let (median, worst) = (ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
    assert!(
        median <= 0.35 && worst <= 0.7,
        "median {median:.2}, worst {worst:.2}"
    );
}

/// The logs of a question, from a unit whose sensors are calibrated, so that what it has beside the asked effects is small.
fn drawn(plant: &str, q: &Question) -> Result<Logs, MachineError> {
    let mut rng = StdRng::seed_from_u64(q.seed);
    let outside = ["stick_slip", "respiration", "pinch"][rng.random_range(0..3)];
    let names = if q.content == Content::Outside {
        vec![outside]
    } else {
        q.names.clone()
    };
    let seed = rng.random_range(1..1_000_000u32).to_string();
    let unit = ["--calibrated", "--seed", &seed].map(str::to_owned);
    let gains = Command::new(plant)
        .args(&unit)
        .arg("--calib")
        .output()
        .unwrap();
    let calib: Calibration =
        source::parse("plant --calib", &String::from_utf8(gains.stdout).unwrap()).unwrap();
    let lines = calib.lines().map(|l| Line {
        k_epsilon: l.k_epsilon * rng.random_range(0.94..1.06),
        k_lambda_mm: l.k_lambda_mm * rng.random_range(0.9..1.1),
    });
    let log = |names: &[&str], size: f64, schedule: u64| {
        let effects = [
            "--size".to_owned(),
            size.to_string(),
            "--effect".to_owned(),
            names.join(","),
        ];
        let arguments: Vec<String> = unit
            .iter()
            .cloned()
            .chain(effects.into_iter().filter(|_| !names.is_empty()))
            .collect();
        record(|_| Link::start(plant, &arguments), &lines, schedule, true)
    };
    let (first, second) = (rng.next_u64(), rng.next_u64());
    // an effect that is hardly visible is made larger, a wall comes nearer
    let hidden = |n: usize, size: f64| {
        let rest: Vec<&str> = names
            .iter()
            .enumerate()
            .filter(|(k, _)| *k != n)
            .map(|(_, name)| *name)
            .collect();
        let [without, with] = [rest.as_slice(), names.as_slice()]
            .map(|names| log(names, size, first).map(|l| Recorded::new(l, &lines)));
        Ok::<_, MachineError>(without?.hides(&with?, q.lab))
    };
    let (mut size, mut too_small) = (1.0, false);
    for n in 0..names.len() {
        let mut hides = hidden(n, size)?;
        while hides && (0.5..3.0).contains(&size) {
            size *= if names.contains(&"contact") { 0.8 } else { 1.4 };
            hides = hidden(n, size)?;
        }
        too_small |= hides;
    }
    let (mut asked, mut fresh) = (log(&names, size, first)?, log(&names, size, second)?);
    if !q.lab {
        (asked.reference, fresh.reference) = (None, None);
    }
    Ok(Logs {
        log: asked,
        fresh,
        lines,
        hidden: too_small,
    })
}

/// The exam of `retroflex gap exam` on a plant that nothing was tuned or trained on. RETROFLEX_SEED and RETROFLEX_ROUNDS choose others.
#[test]
fn the_diagnosis_passes_its_exam() {
    let Some(folder) = compiled() else { return };
    let plant = folder.path().join("plant").display().to_string();
    let (seed, rounds) = (
        variable("RETROFLEX_SEED", 1),
        variable("RETROFLEX_ROUNDS", 1),
    );
    let asked = questions(seed, usize::try_from(rounds).unwrap());
    let answers = answer_all(&asked, |q| drawn(&plant, q), &catalogue(), || ()).unwrap();
    let s = score(seed, &asked, &answers);
    println!("seed {seed}, {} logs\n{}", s.logs, summary(&s));
    let share = |r: &Row| (r.lab.right + r.field.right) as f64 / (r.lab.of + r.field.of) as f64;
    let (single, alarm, outside) = (
        share(&s.diagnosis.single),
        share(&s.diagnosis.alarm),
        share(&s.outside),
    );
    assert!(
        single > 0.85 && alarm < 0.1 && outside > 0.8,
        "{single} {alarm} {outside}"
    );
    assert!(
        s.effects.error < 0.1 && s.unknown.error < 0.1,
        "{} {}",
        s.effects.error,
        s.unknown.error
    );
}
