//! The loop on a plant in C that shares no code with the library.

use crate::plant_in_c::{
    Case, Cold, Figures, compiled, evaluated, helps, measure_all, rows, variable,
};
use retroflex::experiment::evaluation::Arm;

#[test]
fn the_loop_helps_on_an_independent_plant() {
    let Some(folder) = compiled() else { return };
    let case = |effect, cold| Case {
        effect,
        value: None,
        seed: 1,
        cold,
    };
    let cases = [
        case("none", Cold::Paper),
        case("hysteresis", Cold::Own),
        case("crosstalk", Cold::Own),
        case("gas_compression", Cold::Paper),
    ];
    let measured = measure_all(&folder, &cases);
    assert!(
        measured.iter().all(|(_, f)| helps(f) && f.unsettled == 0),
        "{measured:?}"
    );
}

#[test]
fn a_base_imu_keeps_the_bend_while_the_base_sways() {
    let Some(folder) = compiled() else { return };
    let case = Case {
        effect: "sway",
        value: Some(0.17),
        seed: 2,
        cold: Cold::Own,
    };
    let closed = |more: &[&str]| {
        evaluated(&folder, &case, &[Arm::Closed], more)
            .arm(Arm::Closed)
            .unwrap()
            .bend_rmse_deg
    };
    let (with, without) = (closed(&["--base-imu"]), closed(&[]));
    println!("sway of 10 degrees: {with:.2} with a base IMU, {without:.2} without");
    assert!(
        with < WITH_BASE_IMU_MAX_DEG && with < without,
        "{with} {without}"
    );
}

/// Sways of 3 and 10 degrees, and of 3 degrees with turns, on five units from `first` on, with their own gains.
fn swaying(folder: &tempfile::TempDir, first: u64) -> Vec<(Case, Figures)> {
    let sizes = |seed| {
        [("sway", 0.05), ("sway", 0.17), ("sway,base_motion", 0.05)]
            .map(|(effect, value)| (effect, Some(value), seed))
    };
    let case = |(effect, value, seed)| Case {
        effect,
        value,
        seed,
        cold: Cold::Own,
    };
    measure_all(
        folder,
        &(first..first + 5)
            .flat_map(sizes)
            .map(case)
            .collect::<Vec<_>>(),
    )
}

/// The constants of the estimator were chosen on units 1 to 30.
#[test]
fn a_sway_without_a_base_imu_costs_little() {
    let Some(folder) = compiled() else { return };
    let measured = swaying(&folder, 31);
    let harmed = rows(&measured, |f| f.closed > f.open + 0.5);
    assert!(
        harmed.len() <= 2 && measured.iter().all(|(_, f)| f.closed <= f.open + 2.0),
        "{harmed:#?}"
    );
}

/// `RETROFLEX_SEED` names the first unit.
#[test]
#[ignore = "one run in ten misses the goal, by up to 1.4 degrees more: a sway is recognised after some poses only"]
fn a_sway_without_a_base_imu_costs_at_most_half_a_degree() {
    let Some(folder) = compiled() else { return };
    let measured = swaying(&folder, variable("RETROFLEX_SEED", 1));
    let harmed = rows(&measured, |f| f.closed > f.open + 0.5);
    assert!(
        harmed.is_empty(),
        "{} of {}: {harmed:#?}",
        harmed.len(),
        measured.len()
    );
}

/// Bend RMSE with a base IMU that is mounted within 3 degrees.
const WITH_BASE_IMU_MAX_DEG: f64 = 1.0;
