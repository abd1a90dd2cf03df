//! Recorded flights, `tests/replay/*.mcap`, replay bit for bit: whoever changes what the loop decides sees it here.
//!
//! `REFRESH=1 cargo test --test program replay_golden` writes the flights anew; that is deterministic.

use crate::common::flight::fly;
use crate::common::repo;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::drill::bench::{Bench, bend};
use retroflex::motion::machine::Alarm;
use retroflex::supervisor::cycle::order::Order;
use std::path::{Path, PathBuf};
use std::process::Command;

const REFRESH: &str = "REFRESH=1 cargo test --test program replay_golden";
/// Name of each flight, its estimator, and its script.
const FLIGHTS: [(&str, &str, Script); 6] = [
    ("backlash", "bend", there_and_back),
    ("fault", "bend", a_fault),
    ("madgwick", "madgwick", there_and_back),
    ("vqf", "vqf", there_and_back),
    ("vqf-long", "vqf-long", there_and_back),
    ("mekf", "mekf", there_and_back),
];
const DURATION_S: f64 = 4.0;

type Script = fn(u64, &mut Bench) -> Option<Order>;

/// A bend, a reversal that crosses the backlash, and another direction.
fn there_and_back(ms: u64, _: &mut Bench) -> Option<Order> {
    match ms {
        700 => Some(Order::Arm),
        800 => Some(bend(25.0, 20.0)),
        2000 => Some(bend(12.0, 20.0)),
        3200 => Some(bend(15.0, 80.0)),
        _ => None,
    }
}

/// A pressure alarm in motion, its reset, and the next bend.
fn a_fault(ms: u64, bench: &mut Bench) -> Option<Order> {
    match ms {
        1300 => bench.runner.machine.alarm = Some(Alarm::Pressure { kpa: 60.0 }),
        1700 => bench.runner.machine.clear_faults(),
        _ => {}
    }
    match ms {
        700 | 2200 => Some(Order::Arm),
        800 => Some(bend(25.0, 200.0)),
        2000 => Some(Order::Reset),
        2400 => Some(bend(20.0, 230.0)),
        _ => None,
    }
}

fn path(name: &str) -> PathBuf {
    repo("tests/replay").join(name).with_extension("mcap")
}

fn write(path: &Path, filter: &str, script: Script) -> u64 {
    // a short alignment keeps the flight short
    let text = format!("[fuse]\nfilter = \"{filter}\"\n[fuse.align]\nwindow_s = 0.3\n");
    let gains: Gains = source::parse("gains", &text).unwrap();
    fly(path, gains, DURATION_S, script).1
}

fn retroflex(args: &[&str], log: &Path) -> (bool, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
        .args(args)
        .arg(log)
        .output()
        .unwrap();
    (
        out.status.success(),
        String::from_utf8_lossy(&[out.stdout, out.stderr].concat()).into_owned(),
    )
}

#[test]
fn recorded_flights_replay_bit_for_bit() {
    if std::env::var_os("REFRESH").is_some() {
        std::fs::create_dir_all(repo("tests/replay")).unwrap();
        for (name, filter, script) in FLIGHTS {
            // a log never replaces a file, and another test may be reading this one
            let new = path(name).with_extension("new");
            let bytes = write(&new, filter, script);
            std::fs::rename(new, path(name)).unwrap();
            eprintln!("{name}: {bytes} bytes");
            assert!(bytes < 300_000, "{name}: {bytes} bytes");
        }
    }
    if cfg!(not(target_arch = "x86_64")) {
        eprintln!(
            "skipped: the flights were recorded on x86_64, and the mathematics of another processor may differ in the last bit"
        );
        return;
    }
    let mut failed = String::new();
    for (name, ..) in FLIGHTS {
        let (equal, text) = retroflex(&["replay"], &path(name));
        if !equal || !text.contains("4000 cycles replayed, 0 differ") {
            failed += &format!("{name}: {text}");
        }
    }
    assert!(
        failed.is_empty(),
        "{failed}If the loop was meant to change: {REFRESH}"
    );
}

#[test]
fn the_flights_show_what_they_are_for() {
    let (_, text) = retroflex(&["log", "info"], &path("fault"));
    assert!(
        text.contains("mode faulted") && text.contains("mode tracking"),
        "{text}"
    );
    for (name, filter, _) in FLIGHTS {
        let (_, text) = retroflex(&["replay", "--filter", filter], &path(name));
        // the same filter again changes nothing
        let changes: Vec<&str> = text
            .lines()
            .filter(|line| line.contains(" mm ") || line.contains('°'))
            .collect();
        assert!(
            changes.len() == 5 && changes.iter().all(|line| line.contains("0.0000")),
            "{name}: {text}"
        );
    }
    let (_, text) = retroflex(&["replay", "--filter", "mekf"], &path("backlash"));
    let estimate = text
        .lines()
        .find(|line| line.contains("estimated bend"))
        .unwrap_or_default();
    assert!(
        text.contains("This is speculation") && !estimate.contains("0.0000"),
        "{text}"
    );
}

/// Equal programs write equal files, so that a refresh changes only what the loop changes.
#[test]
fn a_refresh_is_deterministic() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    for log in [&a, &b] {
        write(log, "bend", there_and_back);
    }
    assert!(std::fs::read(a).unwrap() == std::fs::read(b).unwrap());
}
