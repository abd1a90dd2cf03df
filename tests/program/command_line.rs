//! The program from outside: results, exit codes, and one clear error for each kind of bad input.

use crate::common::flat;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// Exit code, stdout, stderr.
fn retroflex(args: &[&str]) -> (i32, String, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        // the layout of errors depends on the terminal
        .env("NO_COLOR", "1")
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (
        out.status.code().unwrap_or(-1),
        text(&out.stdout),
        text(&out.stderr),
    )
}

/// Expects exit code 2, one error that contains all of `words`, and no result.
fn refused(args: &[&str], words: &[&str]) {
    let folder = TempDir::new().unwrap();
    let json = folder.path().join("r.json");
    let mut all = args.to_vec();
    all.extend(["--json", json.to_str().unwrap()]);
    let (code, _, stderr) = retroflex(&all);
    let error = flat(&stderr);
    println!("{args:?}\n{stderr}");
    assert_eq!(code, 2, "{error}");
    for w in words {
        assert!(error.contains(w), "`{w}` is not in: {error}");
    }
    // one error, no panic, no backtrace
    assert!(
        stderr.matches("error: ").count() == 1
            && !error.contains("panicked")
            && !error.contains("RUST_BACKTRACE"),
        "{stderr}"
    );
    assert!(!json.exists(), "a refused run writes no result");
}

fn file(folder: &TempDir, name: &str, text: &str) -> String {
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn errors_in_files_name_line_key_and_range() {
    let folder = TempDir::new().unwrap();
    refused(
        &["evaluate", "--board", "/nowhere/board.toml"],
        &["/nowhere/board.toml", "there is no such file"],
    );
    let cases: [(&str, &str, &[&str]); 18] = [
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, 2.2, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.9]\ndate = \"yesterday\"\n",
            &["line 4", "transmission.date", "YYYY-MM-DD"],
        ),
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, 2.2, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.9]\n[imu.gyro_bias_rad_s]\nvalue = [0.0, 0.0, 0.0]\nsigma = [0.001, 0.001, 0.001]\ndate = \"2026-02-30\"\nsource = \"\"\n",
            &["imu.gyro_bias_rad_s.date", "YYYY-MM-DD"],
        ),
        (
            "--board",
            "[service]\nsocket = \"\"\n",
            &["line 2", "service.socket", "empty"],
        ),
        (
            "--board",
            "[service]\nstatus_socket = \"\"\n",
            &["line 2", "service.status_socket", "empty"],
        ),
        (
            "--board",
            "[service]\nstate = \"\"\n",
            &["line 2", "service.state", "empty"],
        ),
        (
            "--track",
            "t_s,bend_deg,dir_deg,bend_deg\n0,10,0,20\n1,20,0,10\n",
            &["line 1", "column bend_deg", "twice"],
        ),
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, 2.5]\nk_lambda_mm = [0.9, 0.9, 0.9]\n",
            &["line 2", "length 2"],
        ),
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, nan, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.9]\n",
            &["line 2", "k_epsilon[2]", "NaN", "0 to 10"],
        ),
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, 2.2, 2.2]\nk_lambda_mm = [0.9, 0.9, -0.1]\n",
            &["line 3", "k_lambda_mm[3]", "-0.1", "0 to 3"],
        ),
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, 2.2, 55.0]\nk_lambda_mm = [0.9, 0.9, 0.9]\n",
            &["line 2", "k_epsilon[3]", "55", "0 to 10"],
        ),
        (
            "--calib",
            "[transmission]\nk_epsilon = [2.2, 2.2, 2.2]\n",
            &["k_lambda_mm"],
        ),
        ("--calib", "", &["transmission"]),
        (
            "--gains",
            "[loop]\nki_s = 0.1\n",
            &["line 2", "ki_s", "ki_1_s"],
        ),
        (
            "--gains",
            "[loop]\nki_1_s = \"100 ms\"\n",
            &["line 2", "the text \"100 ms\"", "expected a number"],
        ),
        (
            "--gains",
            "[loop]\nki_1_s = 10000\n",
            &["line 2", "loop.ki_1_s", "10000 1/s", "0.1 to 1000 1/s"],
        ),
        (
            "--board",
            "[geometry]\nrest_length_mm = 0.02\n",
            &[
                "line 2",
                "geometry.rest_length_mm",
                "0.02 mm",
                "5 to 100 mm",
            ],
        ),
        (
            "--board",
            "[plant.line]\nk_epsilon = [2.2, inf, 2.2]\n",
            &["line 2", "plant.line.k_epsilon[2]", "inf"],
        ),
        (
            "--board",
            "[plant]\nperiod_s = 5\n",
            &["line 2", "plant.period_s", "5 s", "0.0001 to 0.01 s"],
        ),
    ];
    for (n, (option, text, words)) in cases.into_iter().enumerate() {
        let name = format!("case{n}.toml");
        let path = file(&folder, &name, text);
        let mut all = vec![name.as_str()];
        all.extend(words);
        refused(&["evaluate", option, &path], &all);
    }
    refused(
        &["evaluate", "--board", folder.path().to_str().unwrap()],
        &["this is a folder"],
    );
    let binary = folder.path().join("binary.toml");
    std::fs::write(&binary, [0xff, 0xfe, 0x00]).unwrap();
    refused(
        &["evaluate", "--gains", binary.to_str().unwrap()],
        &["binary.toml", "UTF-8"],
    );
}

#[test]
fn contradictory_and_unknown_arguments_are_rejected() {
    let folder = TempDir::new().unwrap();
    let bare = file(&folder, "bare.toml", "[geometry]\ntriangle_side_mm = 7.0\n");
    refused(
        &["evaluate", "--board", &bare],
        &["bare.toml", "[plant]", "--plant"],
    );
    refused(
        &["evaluate", "--arms", "closed,closed"],
        &["--arms", "closed", "twice"],
    );
    refused(&["evaluate", "--arms", "open"], &["open", "extension"]);
    refused(&["evaluate", "--seed", "-3"], &["-3"]);
    refused(
        &["evaluate", "--plant", "./plant"],
        &["./plant", "exec:PROGRAM"],
    );
    refused(&["evaluate", "--plant", "exec:"], &["exec:", "no program"]);
    refused(&["evaluate", "--plant", "exec:sh 'x"], &["quote"]);
    refused(
        &["evaluate", "--html", "/nowhere/r.html"],
        &["/nowhere/r.html", "does not exist"],
    );
    let both = folder.path().join("r.out");
    let both = both.to_str().unwrap();
    let (code, _, stderr) = retroflex(&["evaluate", "--json", both, "--html", both]);
    assert_eq!(code, 2);
    assert!(
        flat(&stderr).contains("both --json and --html name this file"),
        "{stderr}"
    );
    assert_eq!(retroflex(&["evaluat"]).0, 2);
    assert_eq!(retroflex(&[]).0, 2);
}

const HELLO: &str =
    r#"{"plant":"sh","protocol":1,"imu_period_s":0.005,"step_mm":0.029452,"rest_length_mm":20.0}"#;
const STILL: &str = r#""imu":{"acc":[0,0,9.81],"gyr":[0,0,0],"mag":[20,0,-40]}"#;

/// A plant written as a shell script.
fn shell(folder: &TempDir, name: &str, body: &str) -> String {
    let path = file(folder, name, body);
    format!("exec:sh '{path}'")
}

#[test]
fn invalid_or_dying_plants_end_the_run() {
    let folder = TempDir::new().unwrap();
    let greet = format!("echo '{HELLO}'\n");
    // answers every line with the requested time
    let answer = |rest: &str| {
        format!(
            "{greet}n=0; while read l; do t=${{l#*\\\"t\\\":}}; t=${{t%%,*}}; n=$((n+1)); {rest} done\n"
        )
    };
    let cases: [(&str, String, &[&str]); 9] = [
        (
            "mute.sh",
            "exit 7\n".to_owned(),
            &["plant ended", "exit status: 7"],
        ),
        (
            "rude.sh",
            "echo hello; sleep 1\n".to_owned(),
            &["`hello`", "not a greeting"],
        ),
        (
            "later.sh",
            greet.replace("\"protocol\":1", "\"protocol\":2"),
            &["protocol 2"],
        ),
        (
            "inches.sh",
            greet.replace("0.029452", "0"),
            &["step_mm = 0"],
        ),
        (
            "dies.sh",
            answer(&format!(
                "[ $n -gt 50 ] && exit 3; echo \"{{\\\"t\\\":$t,{}}}\";",
                STILL.replace('"', "\\\"")
            )),
            &["plant ended after", "0.25"],
        ),
        (
            "liar.sh",
            answer("echo \"{\\\"t\\\":9.5,\\\"imu\\\":null}\";"),
            &["answers for t = 9.5"],
        ),
        (
            "garbage.sh",
            answer("echo \"{\\\"t\\\":$t,\\\"imu\\\":{\\\"acc\\\":[0,0]\";"),
            &["not an answer", "\"acc\":[0,0]"],
        ),
        (
            "nan.sh",
            answer(
                "echo \"{\\\"t\\\":$t,\\\"imu\\\":{\\\"acc\\\":[0,0,NaN],\\\"gyr\\\":[0,0,0],\\\"mag\\\":null}}\";",
            ),
            &["NaN", "not an answer"],
        ),
        (
            "secretive.sh",
            answer(&format!(
                "echo \"{{\\\"t\\\":$t,{}}}\";",
                STILL.replace('"', "\\\"")
            )),
            &["no `ref`"],
        ),
    ];
    for (name, body, words) in &cases {
        refused(
            &[
                "evaluate",
                "--plant",
                &shell(&folder, name, body),
                "--arms",
                "closed",
                "--calib",
                "calib/paper.toml",
            ],
            words,
        );
    }
    refused(
        &["evaluate", "--plant", "exec:/nowhere/plant --fast"],
        &["/nowhere/plant", "cannot be started"],
    );
}

#[test]
fn a_silent_plant_ends_the_run() {
    let folder = TempDir::new().unwrap();
    let hung = shell(
        &folder,
        "hangs.sh",
        &format!("echo '{HELLO}'; read l; exec sleep 60\n"),
    );
    refused(
        &["evaluate", "--plant", &hung, "--calib", "calib/paper.toml"],
        &["silent for 5 s", "protocol"],
    );
}

#[test]
fn a_tip_that_never_stands_still_cannot_be_aligned() {
    let folder = TempDir::new().unwrap();
    let body = format!(
        "echo '{HELLO}'; s=1; while read l; do t=${{l#*\\\"t\\\":}}; t=${{t%%,*}}; s=$((0-s)); echo \"{{\\\"t\\\":$t,\\\"imu\\\":{{\\\"acc\\\":[0,0,9.8],\\\"gyr\\\":[$s,0,0],\\\"mag\\\":null}}}}\"; done\n"
    );
    refused(
        &[
            "evaluate",
            "--plant",
            &shell(&folder, "sways.sh", &body),
            "--calib",
            "calib/paper.toml",
        ],
        &["not still", "gyroscope"],
    );
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn results_have_the_documented_form() {
    let folder = TempDir::new().unwrap();
    let [result, page, drawing]: [PathBuf; 3] =
        ["r.json", "r.html", "r.svg"].map(|n| folder.path().join(n));
    let (code, stdout, stderr) = retroflex(&[
        "evaluate",
        "--seed",
        "4",
        "--json",
        result.to_str().unwrap(),
        "--html",
        page.to_str().unwrap(),
        "--svg",
        drawing.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.contains("seed 4") && stdout.contains("closed"),
        "{stdout}"
    );
    let r = json(&result);
    let names: Vec<_> = r["arms"]
        .as_array()
        .unwrap()
        .iter()
        .map(|a| a["name"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(
        names,
        ["none", "extension", "backlash", "diagnosed", "closed"]
    );
    for a in r["arms"].as_array().unwrap() {
        assert_eq!(a["states"], 120);
        assert!(
            ["bend_rmse_deg", "orientation_rmse_deg", "settle_s_median"]
                .iter()
                .all(|k| a[k].as_f64().is_some_and(|v| v >= 0.0)),
            "{a}"
        );
    }
    assert!(
        r["k_eps"].as_array().unwrap().len() == 3
            && r["k_lambda_mm"].as_array().unwrap().len() == 3
    );
    assert!((1..=7).contains(&r["iterations"].as_u64().unwrap()));
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.starts_with("<!DOCTYPE html>") && html.matches("<figure>").count() == 6);
    assert!(
        !html.contains("<script")
            && !html.contains("src=")
            && !html.contains("href=")
            && !html.contains("NaN")
    );
    assert_eq!(html.matches("<svg").count(), html.matches("</svg>").count());
    assert!(
        std::fs::read_to_string(&drawing)
            .unwrap()
            .starts_with("<svg")
    );
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        3,
        "no temporary files remain"
    );
}

#[test]
fn a_result_that_is_not_good_enough_is_written_too() {
    let folder = TempDir::new().unwrap();
    let result = folder.path().join("r.json");
    // a feedback with little authority cannot correct a calibration that is far off
    let gains = file(
        &folder,
        "weak.toml",
        "[loop]\nintegral_max_deg = 0.5\nkp = 0.05\n[refine]\nenabled = false\n",
    );
    let calib = file(
        &folder,
        "off.toml",
        "[transmission]\nk_epsilon = [1.0, 1.0, 1.0]\nk_lambda_mm = [0.1, 0.1, 0.1]\n",
    );
    let (code, stdout, stderr) = retroflex(&[
        "evaluate",
        "--arms",
        "closed",
        "--gains",
        &gains,
        "--calib",
        &calib,
        "--json",
        result.to_str().unwrap(),
    ]);
    assert_eq!(code, 1, "{stdout}{stderr}");
    let r = json(&result);
    assert!(r["arms"][0]["bend_rmse_deg"].as_f64().unwrap() > 1.5);
    assert_eq!(
        (r["iterations"].as_u64(), r["k_eps"][0].as_f64()),
        (Some(0), Some(1.0))
    );
}

#[test]
fn the_loop_controls_a_foreign_plant_within_a_degree() {
    if let Err(why) = Command::new("python3").arg("--version").output() {
        println!("skipped: python3 is not on this machine ({why})");
        return;
    }
    let folder = TempDir::new().unwrap();
    let result = folder.path().join("r.json");
    let plant = "exec:python3 examples/foreign_plant.py --seed 7";
    let (code, _, stderr) = retroflex(&[
        "evaluate",
        "--plant",
        plant,
        "--arms",
        "closed",
        "--json",
        result.to_str().unwrap(),
    ]);
    assert_eq!(code, 0, "{stderr}");
    let r = json(&result);
    assert_eq!(
        (r["plant"].as_str(), r["arms"][0]["states"].as_u64()),
        (Some("python"), Some(120))
    );
    let rmse = r["arms"][0]["bend_rmse_deg"].as_f64().unwrap();
    println!("bend RMSE {rmse:.2}°");
    assert!(rmse <= 1.0, "{rmse}");
}

#[test]
fn results_never_overwrite_inputs() {
    let folder = TempDir::new().unwrap();
    let recordings = ["a.csv.gz", "b.csv.gz"].map(|name| file(&folder, name, "a recording"));
    let calib = file(&folder, "tip.toml", "[transmission]\n");
    let cases: [(&[&str], &[&str]); 3] = [
        // the shell expands `--json *.csv.gz` to this
        (
            &[
                "imu",
                "score",
                "--all",
                "--json",
                &recordings[0],
                &recordings[1],
            ],
            &["a.csv.gz", "b.csv.gz"],
        ),
        (
            &["imu", "score", &recordings[0], "--json", &recordings[0]],
            &["would overwrite the input file", "a.csv.gz"],
        ),
        (
            &["evaluate", "--calib", &calib, "--svg", &calib],
            &["would overwrite the input file", "tip.toml"],
        ),
    ];
    for (args, words) in cases {
        let (code, _, stderr) = retroflex(args);
        assert!(
            code == 2 && words.iter().all(|w| stderr.contains(w)),
            "{args:?}: {code} {stderr}"
        );
    }
    assert!(
        recordings
            .iter()
            .all(|path| std::fs::read_to_string(path).unwrap() == "a recording")
    );
}

#[test]
fn a_dash_stands_for_standard_output() {
    let (code, stdout, stderr) = retroflex(&["doctor", "--json", "-"]);
    let findings: Value = serde_json::from_str(&stdout).unwrap();
    assert!(
        code <= 1 && findings[0]["what"] == "computer" && stderr.contains("computer"),
        "{stderr}"
    );
}

#[test]
fn help_is_grouped_by_task_and_shells_complete() {
    let (code, help, _) = retroflex(&["--help"]);
    let tasks = [
        "Move:",
        "Bring up:",
        "Calibrate:",
        "Diagnose:",
        "Simulate:",
        "Prove:",
    ];
    assert!(
        code == 0
            && tasks.iter().all(|t| help.contains(t))
            && help.contains("Not a medical device"),
        "{help}"
    );
    // read in a pipe, all of it fits a terminal
    let width = |text: &str| text.lines().map(|l| l.chars().count()).max().unwrap();
    assert!(width(&help) <= 80, "{help}");
    let names = help.lines().filter_map(|line| line.strip_prefix("  "));
    let names = names.filter_map(|line| line.split(' ').next());
    for name in names
        .filter(|name| !name.is_empty() && name.chars().all(|c| c.is_ascii_lowercase() || c == '-'))
    {
        let (code, own, _) = retroflex(&["help", name]);
        assert!(code == 0 && width(&own) <= 100, "{name}: {own}");
    }
    for shell in ["bash", "zsh", "fish"] {
        let (code, script, _) = retroflex(&["completions", shell]);
        assert!(code == 0 && script.contains("evaluate"), "{shell}");
        // boards, filters and faults complete by name, and a board as a file, too
        for name in ["pi-zero2w", "vqf-long", "i2c_nack"] {
            assert!(script.contains(name), "{shell}: {name}");
        }
        let files = match shell {
            "zsh" => script.contains("{compadd sim") && script.contains("; _files}"),
            "fish" => script.contains("-r -F -a \"sim\\t"),
            _ => script.contains("-o default"),
        };
        assert!(files, "{shell}");
    }
}

#[test]
fn the_sweep_names_its_conditions_and_writes_its_rows() {
    let folder = TempDir::new().unwrap();
    let [result, drawing] = ["r.json", "r.svg"].map(|n| folder.path().join(n));
    let (code, stdout, stderr) = retroflex(&[
        "evaluate",
        "--sweep",
        "--only",
        "noise",
        "--json",
        result.to_str().unwrap(),
        "--svg",
        drawing.to_str().unwrap(),
    ]);
    let rows = json(&result)["sweep"].as_array().unwrap().clone();
    assert_eq!(rows.len(), 2, "{stderr}");
    for row in &rows {
        assert_eq!(row["condition"], "noise_factor");
        let figures = [
            "value",
            "open_deg",
            "closed_deg",
            "p95_deg",
            "hunting_deg",
            "cold_deg",
        ];
        assert!(
            figures
                .iter()
                .all(|k| row[k].as_f64().is_some_and(|v| v >= 0.0)),
            "{row}"
        );
    }
    let good = rows.iter().all(|r| r["ok"].as_bool().unwrap());
    assert_eq!(
        (code, stdout.contains("FAILS")),
        (i32::from(!good), !good),
        "{stdout}"
    );
    assert!(
        std::fs::read_to_string(&drawing)
            .unwrap()
            .starts_with("<svg")
    );
    refused(
        &["evaluate", "--sweep", "--only", "gremlins"],
        &["gremlins", "dead_time_s"],
    );
    refused(
        &["evaluate", "--sweep", "--plant", "exec:true"],
        &["--sweep", "--plant"],
    );
    refused(
        &["evaluate", "--ablate", "--svg", "a.svg"],
        &["--ablate", "--svg"],
    );
}
