//! The service under attack, and a memory that was damaged after a kill.

use crate::common::{paper_bench, tries};
use retroflex::drill::bench::BenchConfig;
use retroflex::drill::process::{self, Plan};
use retroflex::drill::row::FaultResult;
use std::path::Path;

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

fn plan<'a>(
    config: &'a BenchConfig,
    scratch: &'a Path,
    selected: &'a dyn Fn(&str) -> bool,
) -> Plan<'a> {
    Plan {
        config,
        program: program(),
        scratch,
        kills: tries() * 5,
        tries: tries(),
        selected,
    }
}

fn assert_all(rows: &[FaultResult]) {
    rows.iter()
        .for_each(|r| eprintln!("{}: {} {}", r.fault, r.message, r.why));
    let failed: Vec<_> = rows
        .iter()
        .filter(|r| !r.ok)
        .map(|r| format!("{}: {}", r.fault, r.why))
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(rows.iter().all(|r| !r.requires.is_empty()));
}

#[test]
fn a_stop_is_answered_under_every_attack_and_nothing_moves_after_it() {
    let folder = tempfile::tempdir().unwrap();
    assert_all(&process::attacks(&plan(&paper_bench(), folder.path(), &|_| true)).unwrap());
}

#[test]
fn a_memory_is_never_believed_falsely_after_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    assert_all(&process::kills(&plan(&paper_bench(), folder.path(), &|_| true)).unwrap());
}

#[test]
fn clients_that_contradict_each_other_fall_silent_or_die_are_survived() {
    let folder = tempfile::tempdir().unwrap();
    let of_clients = |name: &str| {
        [
            "two_clients",
            "stream_silent",
            "client_dies_in_motion",
            "sigterm_while_bent",
        ]
        .contains(&name)
    };
    let rows = process::rows(&plan(&paper_bench(), folder.path(), &of_clients)).unwrap();
    assert_eq!(rows.len(), 4);
    assert_all(&rows);
}
