//! The service under attack, and a memory that was damaged after a kill. `RETROFLEX_TRIES=100` repeats each stop as often.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{repo, twin};
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::drill::bench::BenchConfig;
use retroflex::drill::process;
use retroflex::drill::row::Row;
use std::path::Path;

fn config() -> BenchConfig {
    BenchConfig { board: twin(), calibration: source::read(&repo("calib/paper.toml")).unwrap(), gains: Gains::default() }
}

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

fn tries(default: u32) -> u32 {
    std::env::var("RETROFLEX_TRIES").ok().and_then(|n| n.parse().ok()).unwrap_or(default)
}

fn assert_all(rows: &[Row]) {
    rows.iter().for_each(|r| eprintln!("{}: {} {}", r.fault, r.message, r.why));
    let failed: Vec<_> = rows.iter().filter(|r| !r.ok).map(|r| format!("{}: {}", r.fault, r.why)).collect();
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(rows.iter().all(|r| !r.requires.is_empty()));
}

#[test]
fn a_stop_is_answered_under_every_attack_and_nothing_moves_after_it() {
    let folder = tempfile::tempdir().unwrap();
    assert_all(&process::attacks(&config(), program(), folder.path(), tries(4), &|_| true).unwrap());
}

#[test]
fn a_memory_is_never_believed_falsely_after_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    assert_all(&process::kills(&config(), program(), folder.path(), tries(4) * 5, &|_| true).unwrap());
}
