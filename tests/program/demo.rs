//! `retroflex demo`: the leak is found and mended, and nothing but the report remains.

use std::process::Command;

#[test]
fn the_demonstration_finds_and_mends_the_leak_and_leaves_the_report_alone() {
    let [here, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let mut demo = Command::new(env!("CARGO_BIN_EXE_retroflex"));
    let out = demo
        .arg("demo")
        .current_dir(here.path())
        .env("TMPDIR", scratch.path())
        .env("HOME", here.path())
        .output()
        .unwrap();
    let (stdout, stderr) = (
        String::from_utf8_lossy(&out.stdout),
        String::from_utf8_lossy(&out.stderr),
    );
    assert_eq!(out.status.code(), Some(0), "{stdout}{stderr}");
    assert!(
        stdout.contains("line 2 is sealed") && stdout.contains("The leak is gone"),
        "{stdout}"
    );
    let left: Vec<_> = std::fs::read_dir(here.path())
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    assert_eq!(left, ["retroflex-demo.html"]);
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0);
}

#[test]
fn a_folder_without_permission_is_refused_at_once() {
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(["demo", "--html", "/proc/demo.html"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(
        out.status.code() == Some(2) && said.contains("/proc/demo.html") && out.stdout.is_empty(),
        "{said}"
    );
}
