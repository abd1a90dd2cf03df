//! The loop on a plant in C that shares no code with the library.

use crate::plant_in_c::{Case, Cold, compiled, evaluated, helps, measure_all};
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
        effect: "base_motion.sway",
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

/// Bend RMSE with a base IMU that is mounted within 3 degrees.
const WITH_BASE_IMU_MAX_DEG: f64 = 1.0;

/// An exam asks a program about effects that it lists, and refuses one that lists none.
#[test]
fn an_exam_asks_about_a_program_that_has_effects_by_name() {
    let exam = |plant: &str, json: &std::path::Path| {
        let out = std::process::Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .args(["gap", "exam", "--seed", "2", "--every", "1000", "--plant"])
            .args([plant, "--json"])
            .arg(json)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&[out.stdout, out.stderr].concat()).into_owned();
        (out.status.code(), text)
    };
    let Some(folder) = compiled() else { return };
    let json = folder.path().join("exam.json");
    let plant = format!(
        "exec:{} --calibrated",
        folder.path().join("plant").display()
    );
    let (code, text) = exam(&plant, &json);
    assert_eq!(code, Some(0), "{text}");
    let written: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    let [log] = written["logs"].as_array().unwrap().as_slice() else {
        panic!("{written}");
    };
    assert!(log["diagnosis"]["verdict"].is_object() && written["score"]["logs"] == 1);
    let (code, text) = exam("exec:true", &json);
    assert!(
        code == Some(2) && text.contains("lists no effect"),
        "{text}"
    );
}
