//! A base that sways or turns without an IMU of its own, on a plant in C that shares no code with the library.

use crate::plant_in_c::{Case, Cold, Figures, compiled, measure_all, rows, variable};

/// Sways of 3 and 10 degrees, and of 3 degrees with turns, on five units from `first` on, with their own gains.
fn swaying(folder: &tempfile::TempDir, first: u64) -> Vec<(Case, Figures)> {
    let sizes = |seed| {
        [
            ("base_motion.sway", 0.05),
            ("base_motion.sway", 0.17),
            ("base_motion.sway,base_motion", 0.05),
        ]
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

/// What the base does is not corrected: the loop errs by as much as without a sensor, and a little more. No constant was chosen on these units.
#[test]
fn a_sway_without_a_base_imu_does_not_lead_the_tip_away() {
    let Some(folder) = compiled() else { return };
    let measured = swaying(&folder, 61);
    let harmed = rows(&measured, |f| f.closed > f.open + 0.5);
    println!("{} of {} above open + 0.5°", harmed.len(), measured.len());
    assert!(
        measured.iter().all(|(_, f)| f.closed <= f.open + 3.0),
        "{harmed:#?}"
    );
}

/// The constants of the estimator were chosen on units 1 to 30, those of the loop on 31 to 55.
#[test]
#[ignore = "goal: until a sway of 10 degrees, or of 3 with turns of the base, is noticed it is learned; it costs up to 2.4 degrees more than the open loop"]
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
#[ignore = "known limitation: see the test above"]
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

/// Bases that turn three times by up to 16 degrees; `RETROFLEX_SEED` names the first of 14 units. No constant was chosen on units 81 to 94.
#[test]
fn a_base_that_turns_without_a_base_imu_leads_few_tips_away() {
    let Some(folder) = compiled() else { return };
    let first = variable("RETROFLEX_SEED", 81);
    let case = |seed| Case {
        effect: "base_motion",
        value: None,
        seed,
        cold: Cold::Own,
    };
    let measured = measure_all(&folder, &(first..first + 14).map(case).collect::<Vec<_>>());
    let mut closed: Vec<f64> = measured.iter().map(|(_, f)| f.closed).collect();
    closed.sort_by(f64::total_cmp);
    let harmed = rows(&measured, |f| f.closed > f.open + 0.5);
    let (median, of) = ((closed[6] + closed[7]) / 2.0, measured.len());
    println!(
        "median {median:.2}°, {} of {of} above open + 0.5°",
        harmed.len()
    );
    assert!(median <= 1.0 && harmed.len() <= 5, "{harmed:#?}");
}
