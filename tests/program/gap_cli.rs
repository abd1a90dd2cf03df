//! The gap commands as a process: what they refuse, what they write, and when they write nothing.

use crate::common::flat;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// Exit code and what was printed, on one line, without the drawing characters of the report.
fn retroflex(args: &[&str]) -> (i32, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    (
        out.status.code().unwrap_or(-1),
        flat(&String::from_utf8([out.stdout, out.stderr].concat()).unwrap()),
    )
}

const HEAD: &str = "time_s,piston1_mm,piston2_mm,piston3_mm,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s\n";

/// A log at 50 Hz: rest, then oscillating pistons; `row` may modify a line.
fn log(seconds: f64, rest_s: f64, reach_mm: f64, row: impl Fn(usize, String) -> String) -> String {
    let mut out = HEAD.to_owned();
    for k in 0..(seconds * 50.0) as usize {
        let t = 0.02 * (k + 1) as f64;
        let u = if t < rest_s {
            0.0
        } else {
            reach_mm * ((t - rest_s) * 0.7).sin()
        };
        // a small tilt that follows the pistons, and noise without a generator
        let (bend, noise) = (0.05 * u, ((k * 7919) % 101) as f64 * 4e-4 - 0.02);
        let (s, c) = bend.sin_cos();
        let line = format!(
            "{t:.2},{u:.4},{:.4},0,{:.4},{noise:.4},{:.4},{noise:.5},{:.5},{:.5}\n",
            -u / 2.0,
            9.81 * s + noise,
            9.81 * c,
            -0.01 * u,
            -noise
        );
        out.push_str(&row(k, line));
    }
    out
}

fn good() -> String {
    log(40.0, 3.0, 12.0, |_, l| l)
}

/// Runs `gap diagnose` with every output on a log, and expects exit code 2, one error and no output.
fn refused(log: &str, expected: &[&str]) {
    let folder = TempDir::new().unwrap();
    let path = |n: &str| folder.path().join(n).to_str().unwrap().to_owned();
    std::fs::write(path("bad.csv"), log).unwrap();
    let (code, message) = retroflex(&[
        "gap",
        "diagnose",
        &path("bad.csv"),
        "--json",
        &path("r.json"),
        "--html",
        &path("r.html"),
        "--save",
        &path("m.toml"),
    ]);
    assert_eq!(code, 2, "{message}");
    for w in expected.iter().chain(&["bad.csv"]) {
        assert!(message.contains(w), "`{w}` is not in: {message}");
    }
    assert!(
        !message.contains("panicked") && message.matches("bad.csv").count() == 1,
        "one error: {message}"
    );
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no file is written"
    );
}

#[test]
fn an_undiagnosable_log_is_refused_with_advice_on_what_to_record() {
    let only = |k: usize, at: usize, with: &str, line: String| {
        if k == at { with.to_owned() } else { line }
    };
    let cases: [(String, &[&str]); 13] = [
        (String::new(), &["no rows"]),
        (HEAD.to_owned(), &["no rows"]),
        (
            good().replace("piston3_mm", "piston3"),
            &["line 1", "piston3_mm", "missing"],
        ),
        (
            good().replace("acc_y_m_s2", "acc_why"),
            &["line 1", "acc_y_m_s2", "missing"],
        ),
        (
            log(40.0, 3.0, 12.0, |k, l| {
                only(k, 99, "2.00,0,zero,0,0,0,9.8,0,0,0\n", l)
            }),
            &["line 101", "piston2_mm", "`zero`"],
        ),
        (
            log(40.0, 3.0, 12.0, |k, l| {
                only(k, 99, "2.00,0,inf,0,0,0,9.8,0,0,0\n", l)
            }),
            &["line 101", "piston2_mm", "`inf`"],
        ),
        (
            log(40.0, 3.0, 12.0, |k, l| {
                only(k, 99, "1.00,0,0,0,0,0,9.8,0,0,0\n", l)
            }),
            &["line 101", "time_s", "strictly increase"],
        ),
        (
            good().trim_end().rsplit_once(',').unwrap().0.to_owned(),
            &["gyr_z_rad_s", "cut short"],
        ),
        (
            log(12.0, 3.0, 12.0, |_, l| l),
            &["at least 20 s", "gap excite"],
        ),
        (
            log(40.0, 3.0, 0.0, |_, l| l),
            &["does not move", "gap excite"],
        ),
        (log(40.0, 0.0, 12.0, |_, l| l), &["rest", "at least 2 s"]),
        (
            log(40.0, 3.0, 40.0, |_, l| clipped(&l)),
            &["clipped", "larger range"],
        ),
        (
            blind(&good()),
            &["neither a tip IMU", "reference", "record at least one"],
        ),
    ];
    for (input, expected) in &cases {
        refused(input, expected);
    }
}

/// The line with an x accelerometer that saturates at 8.5 m/s²; the median norm stays plausible.
fn clipped(line: &str) -> String {
    let mut fields: Vec<String> = line.trim_end().split(',').map(str::to_owned).collect();
    let acc: f64 = fields[4].parse().unwrap();
    fields[4] = format!("{:.4}", acc.clamp(-8.5, 8.5));
    fields.join(",") + "\n"
}

/// The log without sensors.
fn blind(text: &str) -> String {
    text.lines()
        .map(|l| l.split(',').take(4).collect::<Vec<_>>().join(",") + "\n")
        .collect()
}

#[test]
fn an_output_that_cannot_be_written_is_refused_before_the_diagnosis() {
    let folder = TempDir::new().unwrap();
    let log = folder.path().join("log.csv");
    std::fs::write(&log, good()).unwrap();
    let log = log.to_str().unwrap();
    let same = folder.path().join("r").to_str().unwrap().to_owned();
    for (args, expected) in [
        (
            vec!["--html", "/nowhere/r.html"],
            vec!["/nowhere/r.html", "does not exist"],
        ),
        (
            vec!["--json", &same, "--html", &same],
            vec!["give each result its own file"],
        ),
        (vec!["--calib", "/nowhere/c.toml"], vec!["/nowhere/c.toml"]),
        (
            vec!["--map", "docs/maps/silverbox_cubic.toml", "--rows", &same],
            vec!["--map", "--rows"],
        ),
    ] {
        let all: Vec<&str> = ["gap", "diagnose", log].into_iter().chain(args).collect();
        let (code, message) = retroflex(&all);
        assert_eq!(code, 2, "{message}");
        for w in expected {
            assert!(message.contains(w), "`{w}` is not in: {message}");
        }
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

fn has_null(v: &Value) -> bool {
    match v {
        Value::Null => true,
        Value::Array(a) => a.iter().any(has_null),
        Value::Object(o) => o.values().any(has_null),
        _ => false,
    }
}

#[test]
fn a_diagnosis_is_written_whole_and_serves_the_other_commands() {
    let folder = TempDir::new().unwrap();
    let path = |n: &str| folder.path().join(n).to_str().unwrap().to_owned();
    let noted: String = good()
        .lines()
        .enumerate()
        .map(|(k, l)| format!("{l},{}\n", if k == 0 { "note,hum" } else { "x,1" }))
        .collect();
    std::fs::write(path("log.csv"), noted).unwrap();
    let (code, message) = retroflex(&[
        "gap",
        "diagnose",
        &path("log.csv"),
        "--json",
        &path("r.json"),
        "--html",
        &path("r.html"),
        "--save",
        &path("m.toml"),
    ]);
    assert_eq!(code, 0, "{message}");
    assert_eq!(message.matches("warning").count(), 1, "{message}");
    assert!(
        message.contains("note, hum") && message.contains("verdict") && message.contains("next:"),
        "{message}"
    );
    let r: Value = serde_json::from_str(&std::fs::read_to_string(path("r.json")).unwrap()).unwrap();
    assert!(!has_null(&r) && r["schema"] == 1 && r["effects"].as_array().unwrap().len() == 26);
    assert!(!r.to_string().contains("\"rad\""), "angles are in degrees");
    let html = std::fs::read_to_string(path("r.html")).unwrap();
    assert!(
        html.starts_with("<!DOCTYPE html>") && !html.contains("<script") && !html.contains("NaN")
    );
    let (code, message) = retroflex(&[
        "gap",
        "check",
        &path("m.toml"),
        &path("log.csv"),
        "--json",
        &path("c.json"),
    ]);
    assert_eq!(code, 0, "{message}");
    let c: Value = serde_json::from_str(&std::fs::read_to_string(path("c.json")).unwrap()).unwrap();
    assert!(
        ["before_deg", "after_deg", "closed"]
            .iter()
            .all(|k| c[k].is_number()),
        "{c}"
    );
    let (code, message) = retroflex(&[
        "gap",
        "excite",
        "--like",
        &path("m.toml"),
        "--out",
        &path("s.csv"),
        "--rounds",
        "2",
        "--seed",
        "7",
    ]);
    assert_eq!(code, 0, "{message}");
    assert!(message.contains("seed 7"), "{message}");
    check_schedule(Path::new(&path("s.csv")));
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        6,
        "no temporary file remains"
    );
}

/// Checks the header, the initial rest, and the limits of bellow, travel, speed and duration.
fn check_schedule(path: &Path) {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(
        lines.next(),
        Some("bend_deg,dir_deg,len_mm,hold_s,speed_mm_s")
    );
    let rows: Vec<Vec<f64>> = lines
        .map(|l| l.split(',').map(|f| f.parse().unwrap()).collect())
        .collect();
    assert!(rows[0][..3] == [0.0, 0.0, 20.0] && rows[0][3] >= 4.0);
    let (mut total, mut before) = (0.0, [0.0f64; 3]);
    for r in &rows {
        let mut now = [0.0f64; 3];
        for (i, piston) in now.iter_mut().enumerate() {
            let q = (r[2] - 20.0)
                - r[0].to_radians()
                    * 4.0415
                    * (r[1].to_radians() + f64::from(i as u32) * std::f64::consts::TAU / 3.0).cos();
            assert!((14.0..=29.0).contains(&(20.0 + q)), "{r:?}");
            *piston = 3.2 * q + 0.87 * q.signum() * f64::from(q.abs() > 1e-9);
        }
        let far = (0..3)
            .map(|i| (now[i] - before[i]).abs())
            .fold(0.0, f64::max);
        assert!(
            now.iter().all(|u| u.abs() <= 30.0) && (1.0..=30.0).contains(&r[4]),
            "{r:?} {now:?}"
        );
        total += far / r[4] + r[3];
        before = now;
    }
    assert!((100.0..=305.0).contains(&total), "{total} s");
}

#[test]
fn a_faulty_model_is_refused_by_key_and_no_schedule_is_written() {
    let folder = TempDir::new().unwrap();
    let path = |n: &str| folder.path().join(n).to_str().unwrap().to_owned();
    let gains = "k_epsilon = [2.2, 2.5, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.8]\nlag_s = 0.03\n";
    let model = |effect: &str| {
        format!("schema = 1\nsource = \"x\"\n[nominal]\n{gains}[with_effects]\n{gains}{effect}")
    };
    for (input, expected) in [
        (
            model("[[effect]]\nname = \"ghost\"\nparams = {}\n"),
            vec!["ghost", "catalogue"],
        ),
        (
            model("[[effect]]\nname = \"creep\"\nparams = { depth = 1.0 }\n"),
            vec!["creep", "depth", "tau"],
        ),
        (
            model(
                "[[effect]]\nname = \"leak\"\nparams = { \"rate@1\" = 0.01, \"rate@2\" = 0.01, \"rate@3\" = 0.01, vacuum_ratio = 1e10 }\n",
            ),
            vec!["line 13", "effect[1].params.vacuum_ratio", "1e10", "0 to 4"],
        ),
        (
            model(
                "[[effect]]\nname = \"leak\"\n[effect.params]\n\"rate@2\" = 0.01\n\"rate@3\" = 0.01\nvacuum_ratio = 1\n",
            ),
            vec!["effect[1].params.rate@1", "missing"],
        ),
        (model("colour = 1\n"), vec!["line", "colour"]),
        (model("").replace("2.5", "25.0"), vec!["k_epsilon[2]", "25"]),
    ] {
        std::fs::write(path("m.toml"), input).unwrap();
        let (code, message) = retroflex(&[
            "gap",
            "excite",
            "--like",
            &path("m.toml"),
            "--out",
            &path("s.csv"),
        ]);
        assert_eq!(code, 2, "{message}");
        for w in expected {
            assert!(message.contains(w), "`{w}` is not in: {message}");
        }
    }
    assert!(!Path::new(&path("s.csv")).exists());
    assert_eq!(
        retroflex(&["gap", "excite", "--out", "/nowhere/s.csv"]).0,
        2
    );
    assert_eq!(
        retroflex(&["gap", "excite", "--out", &path("s.csv"), "--rounds", "0"]).0,
        2
    );
}

#[test]
fn a_calibration_keeps_its_tip_and_its_imu_when_a_model_is_applied() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("tip.toml");
    let out = path.to_str().unwrap();
    let apply = || retroflex(&["gap", "apply", "tests/corpus/model.toml", "--calib", out]);
    let transmission = "[transmission]\ntip = \"A7\"\nk_epsilon = [2.0, 2.0, 2.0]\nk_lambda_mm = [0.8, 0.8, 0.8]\n";
    let imu = "[imu.mount_deg]\nvalue = [0.1, 0.2, 0.3]\nsigma = [0.1, 0.1, 0.1]\ndate = \"2026-01-02\"\nsource = \"bends.csv\"\n";
    for (old, tip, mount) in [
        (None, "", false),
        (Some(transmission.to_owned()), "A7", false),
        (Some(imu.to_owned()), "", true),
        (Some(format!("{transmission}{imu}")), "A7", true),
    ] {
        match &old {
            Some(old) => std::fs::write(&path, old).unwrap(),
            None => assert!(!path.exists()),
        }
        let (code, message) = apply();
        assert_eq!(code, 0, "{message}");
        let table: toml::Table = std::fs::read_to_string(&path).unwrap().parse().unwrap();
        assert_eq!(table["transmission"]["tip"].as_str(), Some(tip), "{old:?}");
        assert_eq!(
            table["transmission"]["k_epsilon"][1].as_float(),
            Some(2.3),
            "{old:?}"
        );
        let kept = table.get("imu").and_then(|imu| imu.get("mount_deg"));
        let kept = kept.and_then(|mount| mount["value"][1].as_float());
        assert_eq!(kept, mount.then_some(0.2), "{old:?}");
    }
    for other in [
        "base = \"pi4\"\n",
        "words\n",
        "[transmission]\nk_epsilon = \"high\"\n",
    ] {
        std::fs::write(&path, other).unwrap();
        let (code, message) = apply();
        assert!(code == 2 && message.contains("tip.toml"), "{message}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), other);
    }
}

#[test]
fn a_mapped_log_is_diagnosed_and_a_faulty_map_refused() {
    let folder = TempDir::new().unwrap();
    let path = |n: &str| folder.path().join(n).to_str().unwrap().to_owned();
    let mut text = "t,u,y\n".to_owned();
    let mut w = 0.0f64;
    for k in 0..3000 {
        let t = f64::from(k) * 0.02;
        let u = (1.0 + (0.2 * t).sin()) * (0.9 * t).sin();
        w = w.max(u - 0.3).min(u + 0.3);
        let _ = writeln!(
            text,
            "{t:.2},{u:.5},{:.5}",
            2.0 * w + 0.002 * f64::from((k * 37) % 11)
        );
    }
    std::fs::write(path("log.csv"), text).unwrap();
    std::fs::write(
        path("m.toml"),
        "input = \"u\"\noutput = \"y\"\ntime = \"t\"\noutput_unit = \"N\"\n",
    )
    .unwrap();
    let run = |map: &str| {
        retroflex(&[
            "gap",
            "diagnose",
            &path("log.csv"),
            "--map",
            map,
            "--json",
            &path("r.json"),
        ])
    };
    let (code, message) = run(&path("m.toml"));
    assert_eq!(code, 0, "{message}");
    let r: Value = serde_json::from_str(&std::fs::read_to_string(path("r.json")).unwrap()).unwrap();
    assert_eq!(
        (
            r["verdict"]["names"][0].as_str(),
            r["unit"].as_str(),
            has_null(&r)
        ),
        (Some("play"), Some("N"), false),
        "{message}"
    );
    std::fs::remove_file(path("r.json")).unwrap();
    for (map, expected) in [
        (
            "input = \"x\"\noutput = \"y\"\n",
            vec!["log.csv", "line 1", "column x", "missing"],
        ),
        (
            "input = \"u\"\noutput = \"y\"\nspeed = 3\n",
            vec!["bad.toml", "line 3", "speed"],
        ),
        (
            "input = \"u\"\noutput = \"y\"\ntime = \"t\"\nrate_hz = 50.0\n",
            vec!["rate_hz", "one clock"],
        ),
        (
            "input = \"u\"\noutput = \"y\"\nnominal = \"resonance\"\n",
            vec!["needs a clock"],
        ),
        (
            "output = \"y\"\n",
            vec!["bad.toml, line 1", "input: names no column", "still"],
        ),
        (
            "input = \"u\"\noutput = \"y\"\nmotion = \"nope\"\n",
            vec!["log.csv", "column nope", "bad.toml", "`motion`"],
        ),
        (
            "output = \"y\"\ninput = [\"u\", \"t\", \" u\"]\n",
            vec!["bad.toml, line 2", "input: column `u` is named twice"],
        ),
        (
            "input = \"u\"\noutput = [\"y\", \"u\"]\n",
            vec!["bad.toml, line 2", "output: column `u` is named twice"],
        ),
    ] {
        std::fs::write(path("bad.toml"), map).unwrap();
        let (code, message) = run(&path("bad.toml"));
        assert_eq!(code, 2, "{message}");
        for w in expected {
            assert!(message.contains(w), "`{w}` is not in: {message}");
        }
        assert!(!Path::new(&path("r.json")).exists());
    }
}

#[test]
fn real_recordings_are_diagnosed_through_their_maps() {
    let real = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/real");
    if !real.is_dir() {
        println!("skipped: {} does not exist", real.display());
        return;
    }
    for (log, expected, same) in [
        (
            "stepper_screw_periodic/sweep.csv.gz",
            "periodic_position",
            Some("periodic_time"),
        ),
        ("pressure_chamber_leak/Ultimaker_015.csv.gz", "leak", None),
        (
            "friction_damper_backlash/0p25Hz_1in.csv.gz",
            "bouc_wen",
            None,
        ),
        ("endoscope_probe_axis1/run1.csv.gz", "hysteresis", None),
    ] {
        let folder = TempDir::new().unwrap();
        let json = folder.path().join("r.json");
        let map = format!("docs/maps/{}.toml", log.split('/').next().unwrap());
        let (code, message) = retroflex(&[
            "gap",
            "diagnose",
            real.join(log).to_str().unwrap(),
            "--map",
            &map,
            "--json",
            json.to_str().unwrap(),
        ]);
        assert_eq!(code, 0, "{message}");
        let r: Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
        let held = |v: &Value| {
            v.as_array()
                .unwrap()
                .iter()
                .flat_map(|g| g.as_array().cloned().unwrap_or_else(|| vec![g.clone()]))
                .collect::<Vec<_>>()
        };
        let named: Vec<Value> = held(&r["verdict"]["names"])
            .into_iter()
            .chain(held(&r["verdict"]["equivalent"]))
            .collect();
        // of the probe, as much remains as an effect of the catalogue does not leave: its memory is a part
        let partly = log.starts_with("endoscope") && r["verdict"]["kind"] == "unknown";
        assert!(
            (r["verdict"]["kind"] == "effects" || partly) && named.contains(&Value::from(expected)),
            "{log}: {message}"
        );
        let set = &r["verdict"]["conformal"];
        assert_eq!(r["verdict"]["kind"], set[0]["kind"], "{log}: {message}");
        if let Some(same) = same {
            assert!(
                named.contains(&Value::from(same)) && message.contains("one speed"),
                "{log}: {message}"
            );
        }
    }
}

/// Recordings of other people's machines: what is right of each, as the people who recorded them or the physics tell.
#[test]
fn field_recordings_are_judged_right() {
    let field = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/field/logs");
    if !field.is_dir() {
        println!("skipped: {} does not exist", field.display());
        return;
    }
    let folder = TempDir::new().unwrap();
    let json = folder.path().join("r.json");
    let diagnosed = |log: &str| {
        let path = field.join(log);
        let map = path.with_file_name("map.toml");
        let (code, message) = retroflex(&[
            "gap",
            "diagnose",
            path.to_str().unwrap(),
            "--map",
            map.to_str().unwrap(),
            "--json",
            json.to_str().unwrap(),
        ]);
        assert_eq!(code, 0, "{message}");
        let r: Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
        // the verdict is the most probable statement of its own 95 % set
        let (verdict, first) = (&r["verdict"], &r["verdict"]["conformal"][0]);
        assert_eq!(verdict["kind"], first["kind"], "{message}");
        if verdict["kind"] != "unknown" {
            assert_eq!(verdict["names"], first["names"], "{message}");
        }
        (r, message)
    };
    let has = |v: &Value, name: &str| v.to_string().contains(&format!("\"{name}\""));
    let named = |r: &Value, name: &str| {
        r["verdict"]["kind"] == "effects"
            && (has(&r["verdict"]["names"], name) || has(&r["verdict"]["equivalent"], name))
    };
    for log in [
        "lag_longer_than_2pct/heater.csv",
        "periodic_below_nyquist/heaters.csv",
    ] {
        let (r, message) = diagnosed(log);
        assert!(named(&r, "lag"), "{log}: {message}");
    }
    let (r, message) = diagnosed("coulomb_hidden_by_8pct/tx40_joint6.csv");
    assert!(named(&r, "coulomb") && named(&r, "viscous"), "{message}");
    let (r, message) = diagnosed("none_explains_nothing/robotarm.csv");
    assert!(r["verdict"]["kind"] == "unknown", "{message}");
    let (r, message) = diagnosed("unknown_too_low/diamond_y.csv");
    assert!(
        r["verdict"]["kind"] == "unknown" && r["unknown"]["probability"].as_f64() >= Some(0.5),
        "{message}"
    );
    assert!(has(&r["verdict"]["names"], "delay"), "{message}");
    let (r, message) = diagnosed("few_poses/tdcr.csv");
    assert!(
        r["verdict"]["kind"] == "unknown" && message.contains("20 distinct"),
        "{message}"
    );
}
