//! `gap compare`: a simulator of somebody else beside a log.

use retroflex::primitives::Steps;
use retroflex::simulation::link::Link;
use retroflex::simulation::world::World;
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

const SIMULATOR: &str =
    "env PYTHONPATH=python/src:examples python3 examples/plant.py --param seed=7";

/// A log of the simulator with these arguments: poses in all directions with holds.
fn record(path: &Path, further: &[&str]) {
    let words: Vec<String> = SIMULATOR
        .split(' ')
        .chain(further.iter().copied())
        .map(str::to_owned)
        .collect();
    let mut link = Link::start(&words[0], &words[1..]).unwrap();
    let (period_s, step_mm) = (link.info().period_s, link.info().step_mm);
    let mut csv = "time_s,piston1_mm,piston2_mm,piston3_mm,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut\n".to_owned();
    let (mut at, mut n) = ([0.0f64; 3], 0);
    let poses = (0..18).map(|k| (f64::from(k % 5) * 15.0, f64::from(k) * 100.0));
    for (bend, dir) in std::iter::once((0.0, 0.0)).chain(poses) {
        let goal = [0.0, 120.0, 240.0]
            .map(|a: f64| -bend.to_radians() * 4.04 * (dir + a).to_radians().cos() * 3.4);
        let hold = if n == 0 { 3.0 } else { 1.5 };
        let moves = (0..3).map(|i| (goal[i] - at[i]).abs()).fold(0.0, f64::max) / 15.0;
        let from = at;
        let ticks = ((moves + hold) / period_s) as u32;
        for k in 1..=ticks {
            let share = (f64::from(k) * period_s / moves.max(1e-9)).min(1.0);
            at = [0, 1, 2].map(|i| from[i] + (goal[i] - from[i]) * share);
            n += 1;
            let counts = at.map(|mm| (mm / step_mm).round() as i32);
            let reply = link.step(&Steps(counts)).unwrap();
            let mm = counts.map(|c| f64::from(c) * step_mm);
            let imu = reply.imu.unwrap();
            let mag = imu.mag_ut.unwrap();
            let t_s = f64::from(n) * period_s;
            write!(csv, "{t_s:.4}").unwrap();
            let values = mm
                .iter()
                .chain(imu.acc_m_s2.iter())
                .chain(imu.gyro_rad_s.iter())
                .chain(mag.iter());
            values.for_each(|x| write!(csv, ",{x:.6}").unwrap());
            csv.push('\n');
        }
    }
    std::fs::write(path, csv).unwrap();
}

/// Exit code, JSON, and what is said.
fn compare(log: &Path, further: &[&str]) -> (i32, Value, String) {
    let json = log.with_extension("json");
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args([
            "gap",
            "compare",
            log.to_str().unwrap(),
            "--json",
            json.to_str().unwrap(),
        ])
        .args(further)
        .output()
        .unwrap();
    let said =
        String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
    let text = std::fs::read_to_string(&json).unwrap_or("null".to_owned());
    (
        out.status.code().unwrap_or(-1),
        serde_json::from_str(&text).unwrap(),
        said,
    )
}

/// A log of the simulator in a folder of its own; `None`, with the reason printed, without Python.
fn recorded() -> Option<(tempfile::TempDir, std::path::PathBuf)> {
    if Command::new("python3").arg("--version").output().is_err() {
        println!("skipped: there is no python3");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.csv");
    record(&log, &[]);
    Some((folder, log))
}

#[test]
fn a_simulator_fits_its_own_log_and_a_wrong_stiffness_is_seen_and_found() {
    let Some((folder, log)) = recorded() else {
        return;
    };
    let simulator = |more: &str| format!("exec:{SIMULATOR}{more}");
    let residuals = folder.path().join("r.parquet");
    let (code, own, said) = compare(
        &log,
        &[
            "--plant",
            &simulator(""),
            "--residuals",
            residuals.to_str().unwrap(),
        ],
    );
    let left = |v: &Value| v["plant"]["rmse_deg"].as_f64().unwrap();
    let floor = own["noise_floor_deg"].as_f64().unwrap();
    assert!(
        code == 0 && said.starts_with("The simulator fits the log") && left(&own) < floor + 0.1,
        "{said}"
    );
    assert!(
        own["plant"]["name"] == "python" && own["schema"] == 1,
        "{own}"
    );
    assert!(std::fs::read(&residuals).unwrap().starts_with(b"PAR1"));

    let (_, stiff, said) = compare(&log, &["--plant", &simulator(" --param stiffness=0.8")]);
    assert!(
        left(&stiff) > floor + 1.0 && !said.starts_with("The simulator fits"),
        "{said}"
    );

    for range in ["stiffness=0.5:2", "stiffness=0.3:1.2"] {
        let (code, found, said) = compare(&log, &["--plant", &simulator(""), "--fit", range]);
        let param = &found["params"][0];
        let [low, high] = [0, 1].map(|i| param["ci95"][i].as_f64().unwrap());
        println!("{said}");
        assert!(code == 0 && left(&found) < floor + 0.1, "{said}");
        // the accelerometer of that tip has a bias, which the fit takes for stiffness
        let value = param["value"].as_f64().unwrap();
        assert!((value - 1.0).abs() < 0.01, "{param}");
        assert!(
            low <= value && value <= high && high - low < 0.02,
            "{param}"
        );
    }
}

#[test]
fn a_parameter_that_changes_nothing_is_told() {
    let Some((_folder, log)) = recorded() else {
        return;
    };
    let simulator = format!("exec:{SIMULATOR}");
    for name in ["stiffnes", "mass"] {
        let range = format!("{name}=0.5:2");
        let (code, found, said) = compare(&log, &["--plant", &simulator, "--fit", &range]);
        assert!(code == 0 && said.contains("changes nothing"), "{said}");
        assert_eq!(found["params"][0]["ci95"], serde_json::json!([0.5, 2.0]));
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, part) in [
        (
            &["--plant", "exec:cat", "--fit", "a=2:1"][..],
            "NAME=LOW:HIGH",
        ),
        (&["--plant", "cat"], "exec:PROGRAM"),
        (&["--plant", "exec:/nowhere/x"], "cannot be started"),
        (&["--plant", "exec:true"], "plant ended"),
    ] {
        let log = folder.path().join("leak.csv.gz");
        std::fs::copy("examples/leak.csv.gz", &log).unwrap();
        let (code, json, said) = compare(&log, arguments);
        assert!(code == 2 && json.is_null() && said.contains(part), "{said}");
    }
}
