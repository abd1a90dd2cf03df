//! The daemon as a whole, from outside: real sockets, real time, the built-in plant.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use retroflex::drill::process::Daemon;
use retroflex::log::bend_log;
use retroflex::service::memory::Store;
use std::path::Path;
use std::process::{Command, Output};

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

/// The command line as a client of a daemon.
fn cli(daemon: &Daemon, args: &[&str]) -> (i32, String) {
    let Output { status, stdout, stderr } = Command::new(program()).args(args).env("RETROFLEX_SOCKET", daemon.socket()).output().unwrap();
    (status.code().unwrap(), String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr))
}

#[test]
fn a_day_in_its_life() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    daemon.until(10.0, "alignment", |s| s["mode"] == "disarmed").unwrap();

    // boots disarmed: no command moves it, and every refusal says what helps
    let (code, said) = cli(&daemon, &["bend", "30"]);
    assert!(code == 1 && said.contains("arm"), "{said}");
    let (code, said) = cli(&daemon, &["record", "start", "../x"]);
    assert!(code == 2 && said.contains("no name of a recording"), "{said}");

    // recorded from rest, it can be replayed; the command ends when the rest that begins it is found
    let (code, said) = cli(&daemon, &["record", "start", "day"]);
    assert!(code == 0 && said.contains("\"replayable\":true"), "{said}");
    let (code, said) = cli(&daemon, &["arm"]);
    assert_eq!(code, 0, "{said}");
    let (code, said) = cli(&daemon, &["bend", "40", "--toward", "30", "--wait"]);
    assert!(code == 0 && said.contains("settled"), "{said}");
    let status = daemon.until(2.0, "status", |_| true).unwrap();
    assert!((status["felt"]["bend_deg"].as_f64().unwrap() - 40.0).abs() < 1.0, "{status}");
    assert_eq!(cli(&daemon, &["bend", "10", "--toward", "-90", "--speed", "20"]).0, 0);
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(cli(&daemon, &["stop"]).0, 0);
    let status = daemon.until(2.0, "the stop", |s| s["mode"] == "holding").unwrap();
    assert!(status["felt"]["bend_deg"].as_f64().unwrap() > 20.0, "stopped on the way: {status}");
    assert_eq!(cli(&daemon, &["relax"]).0, 0);
    daemon.until(10.0, "rest", |s| s["mode"] == "disarmed" && s["counted"] == serde_json::json!([0, 0, 0])).unwrap();
    let (code, said) = cli(&daemon, &["record", "stop"]);
    assert_eq!(code, 0, "{said}");

    // what it recorded is a bend log as any other, and the loop of today decides the same
    let log = folder.path().join("state/recordings/day.csv");
    let read = bend_log::read(&log).unwrap();
    assert!(read.ignored.is_empty() && read.t_s.len() > 1000 && read.imu.is_some());
    let replayed = Command::new(program()).arg("replay").arg(&log).output().unwrap();
    let said = String::from_utf8_lossy(&replayed.stdout).into_owned();
    assert!(replayed.status.success() && said.contains(" 0 differ"), "{said}");
    // one flipped bit of what was decided is noticed
    let tape = folder.path().join("state/recordings/day.csv.tape");
    let mut bytes = std::fs::read(&tape).unwrap();
    let at = bytes.len() - 3;
    bytes[at] ^= 0x10;
    std::fs::write(&tape, bytes).unwrap();
    assert_eq!(Command::new(program()).arg("replay").arg(&log).output().unwrap().status.code(), Some(1));

    // reading needs no right to command
    let status_socket = folder.path().join("status.sock");
    let only = |args: &[&str]| Command::new(program()).args(args).env("RETROFLEX_SOCKET", &status_socket).output().unwrap();
    assert!(only(&["status", "--json"]).status.success());
    assert_eq!(only(&["arm"]).status.code(), Some(1));

    // and it ends at rest, with the disk saying so
    let (well, _) = daemon.end().unwrap();
    assert!(well);
    let (_, recall) = Store::open(&folder.path().join("state")).unwrap();
    let memory = recall.memory.unwrap();
    assert!(!memory.armed && memory.kept.unwrap().steps.0 == [0; 3]);
    let gone = Command::new(program()).arg("status").env("RETROFLEX_SOCKET", folder.path().join("control.sock")).output().unwrap();
    assert_eq!(gone.status.code(), Some(3));
}

#[test]
fn a_second_service_on_the_same_state_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let other = Command::new(program())
        .args(["run", "--socket"])
        .arg(folder.path().join("other.sock"))
        .arg("--state")
        .arg(folder.path().join("state"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&other.stderr).into_owned();
    assert!(other.status.code() == Some(2) && said.contains("another retroflex"), "{said}");
    daemon.end().unwrap();
}
