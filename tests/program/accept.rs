//! `retroflex accept`: on the simulated tip every step passes, nothing but the report remains, and a failed step ends it.

use std::path::Path;
use std::process::{Command, Stdio};

fn accept(here: &Path, scratch: &Path, board: &str) -> (Option<i32>, String) {
    let mut accept = Command::new(env!("CARGO_BIN_EXE_retroflex"));
    accept
        .args(["accept", "--board", board])
        .current_dir(here)
        .env("TMPDIR", scratch)
        .env("HOME", here)
        .stdin(Stdio::null());
    let out = accept.output().unwrap();
    (
        out.status.code(),
        String::from_utf8_lossy(&[out.stdout, out.stderr].concat()).into_owned(),
    )
}

fn rows<'a>(said: &'a str, result: &str) -> Vec<&'a str> {
    said.lines()
        .filter(|line| line.split("  ").any(|cell| cell.trim() == result))
        .collect()
}

#[test]
fn a_simulated_tip_passes_every_step() {
    let [here, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let (code, said) = accept(here.path(), scratch.path(), "demo");
    // the timing of real steps does not concern it
    assert_eq!((code, rows(&said, "passed").len()), (Some(0), 9), "{said}");
    let left: Vec<_> = std::fs::read_dir(here.path())
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    assert_eq!(left, ["retroflex-accept.html"]);
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0);
    let page = std::fs::read_to_string(here.path().join("retroflex-accept.html")).unwrap();
    for part in [
        "wiring: agrees with the board file",
        "$ retroflex calibrate transmission --short",
        "settled",
        "verdict",
    ] {
        assert!(page.contains(part), "{part} is missing: {page}");
    }
}

#[test]
fn a_failed_step_ends_the_procedure() {
    let [here, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    // a line leaks
    let board = "base = \"demo\"\n[plant.effects.leak]\nrate_per_s = [0.0, 0.3, 0.0]\n";
    std::fs::write(here.path().join("board.toml"), board).unwrap();
    let (code, said) = accept(here.path(), scratch.path(), "board.toml");
    assert_eq!((code, rows(&said, "not run").len()), (Some(1), 5), "{said}");
    assert!(
        rows(&said, "FAILED")
            .iter()
            .any(|row| row.contains("wiring and tightness")),
        "{said}"
    );
}

#[test]
fn a_real_machine_is_not_moved_unasked() {
    let [here, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let (code, said) = accept(here.path(), scratch.path(), "pi4");
    assert!(code == Some(2) && said.contains("--yes"), "{said}");
}
