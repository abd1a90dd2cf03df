//! Rows of many diagnoses: they survive a kill, shards merge to the same table, and what differs between lots is found.

use crate::common::repo;
use flate2::read::GzDecoder;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use retroflex::diagnosis::fleet::row::{FleetRow, rows, table};
use retroflex::diagnosis::fleet::{GAINS, Survey};
use retroflex::log::columns;
use std::io::Read;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn retroflex(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_retroflex"));
    command
        .current_dir(folder)
        .args(line.split(' '))
        .stdin(Stdio::null());
    command
}

fn good(folder: &Path, line: &str) -> String {
    let Output {
        status,
        stdout,
        stderr,
    } = retroflex(folder, line).output().unwrap();
    let text = String::from_utf8_lossy(&[stdout, stderr].concat()).into_owned();
    assert!(status.success(), "{line}: {text}");
    text
}

/// Logs of three lengths, and one that cannot be diagnosed.
fn short_logs(folder: &Path) {
    let mut text = String::new();
    GzDecoder::new(std::fs::File::open(repo("examples/leak.csv.gz")).unwrap())
        .read_to_string(&mut text)
        .unwrap();
    for (name, lines) in [
        ("a/one", 4000),
        ("a/two", 4500),
        ("b/three", 5000),
        ("b/four", 3),
        ("b/five", 4200),
        ("a/six", 4600),
    ] {
        let path = folder.join("logs").join(name).with_extension("csv");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let part: Vec<&str> = text.lines().take(lines).collect();
        std::fs::write(path, part.join("\n") + "\n").unwrap();
    }
}

/// Logs that cannot be read: a link to nothing, a link to itself, and a file without permissions, which root may read.
fn unreadable_logs(folder: &Path) {
    let logs = folder.join("logs/c");
    std::fs::create_dir_all(&logs).unwrap();
    std::os::unix::fs::symlink("nowhere.csv", logs.join("gone.csv")).unwrap();
    std::os::unix::fs::symlink("loop.csv", logs.join("loop.csv")).unwrap();
    std::fs::write(logs.join("shut.csv"), "x\n").unwrap();
    let pipe = Command::new("mkfifo").arg(logs.join("pipe.csv")).status();
    assert!(pipe.unwrap().success());
    let shut = std::fs::Permissions::from_mode(0o000);
    std::fs::set_permissions(logs.join("shut.csv"), shut).unwrap();
}

#[test]
fn a_killed_run_resumes_and_shards_merge_to_the_same_table() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    short_logs(folder);
    unreadable_logs(folder);
    // a circle of links
    std::os::unix::fs::symlink("..", folder.join("logs/a/up")).unwrap();
    let text = good(folder, "gap diagnose logs --rows all.parquet");
    assert!(
        text.contains("10 logs, 10 of them diagnosed now; 5 cannot be diagnosed"),
        "{text}"
    );
    let whole = std::fs::read(folder.join("all.parquet")).unwrap();
    let told =
        rows(&columns::read(std::fs::File::open(folder.join("all.parquet")).unwrap()).unwrap())
            .unwrap();
    let of = |log: &str| told.iter().find(|row| row.log == log).unwrap();
    assert_eq!(
        (
            of("b/three.csv").lot.as_str(),
            of("b/three.csv").unit.as_str()
        ),
        ("b", "three")
    );
    assert!(
        of("b/four.csv").verdict.is_empty() && of("b/four.csv").refused.contains("four.csv"),
        "{:?}",
        of("b/four.csv")
    );
    for log in ["c/gone.csv", "c/loop.csv", "c/shut.csv", "c/pipe.csv"] {
        let row = of(log);
        assert!(
            row.verdict.is_empty() && row.refused.contains(log),
            "{row:?}"
        );
    }
    assert!(of("a/one.csv").numbers["p_leak"] >= 0.0 && !of("a/one.csv").verdict.is_empty());
    // nothing is diagnosed twice
    assert!(
        good(folder, "gap diagnose logs --rows all.parquet")
            .contains("10 logs, 0 of them diagnosed now")
    );

    // killed as soon as the first row is kept
    let journal = folder.join("killed.parquet.journal");
    let mut run = retroflex(folder, "gap diagnose logs --rows killed.parquet")
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while std::fs::read_to_string(&journal).is_ok_and(|text| text.lines().count() < 2)
        || !journal.exists()
    {
        assert!(
            run.try_wait().unwrap().is_none(),
            "it ended before it was killed"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    run.kill().unwrap();
    run.wait().unwrap();
    assert!(!folder.join("killed.parquet").exists());
    let text = good(folder, "gap diagnose logs --rows killed.parquet");
    assert!(!text.contains("10 of them diagnosed now"), "{text}");
    assert!(std::fs::read(folder.join("killed.parquet")).unwrap() == whole);

    for k in 1..=3 {
        let shard = format!("gap diagnose logs --rows part-{k}.parquet --shard {k}/3");
        let out = retroflex(folder, &shard).output().unwrap();
        // a part may be empty
        assert!(
            out.status.success()
                || String::from_utf8_lossy(&out.stderr).contains("no log to diagnose")
        );
    }
    let parts: Vec<String> = (1..=3)
        .map(|k| format!("part-{k}.parquet"))
        .filter(|p| folder.join(p).exists())
        .collect();
    good(
        folder,
        &format!(
            "fleet {} --merged merged.parquet --html fleet.html",
            parts.join(" ")
        ),
    );
    assert!(std::fs::read(folder.join("merged.parquet")).unwrap() == whole);
    assert!(
        std::fs::read_to_string(folder.join("fleet.html"))
            .unwrap()
            .contains("<svg")
    );
}

#[test]
fn a_faulty_table_of_units_is_refused_by_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("a.csv"), "x\n").unwrap();
    std::fs::write(folder.join("b.csv"), "x\n").unwrap();
    let run = |units: &str, logs: &str| {
        std::fs::write(folder.join("units.table"), units).unwrap();
        let line = format!("gap diagnose {logs} --rows r.parquet --units units.table");
        let out = retroflex(folder, &line).output().unwrap();
        let text = String::from_utf8_lossy(&out.stderr);
        let words: Vec<&str> = text.split_whitespace().collect();
        (out.status.code(), words.join(" "))
    };
    for (row, place, word) in [
        ("b.csv,u,l,2020-02-31", "line 3, column date", "2020-02-31"),
        ("b.csv,u,l,yesterday", "line 3, column date", "YYYY-MM-DD"),
        ("b.csv,u,l,2020-2-3", "line 3, column date", "YYYY-MM-DD"),
        ("a.csv,u,l,2020-02-03", "line 3, column log", "line 2"),
        ("c.csv,u,l,2020-02-03", "line 3, column log", "no such log"),
    ] {
        let units = format!("log,unit,lot,date\na.csv,u,l,2020-02-01\n{row}\n");
        let (code, text) = run(&units, "a.csv b.csv");
        assert!(
            code == Some(2) && text.contains(place) && text.contains(word),
            "{row}: {text}"
        );
        assert!(!folder.join("r.parquet").exists());
    }
    let (code, text) = run("log,unit\na.csv,u\n", "a.csv none.csv");
    assert!(code == Some(2) && text.contains("none.csv"), "{text}");
    for units in [
        "log,unit,lot,date\na.csv,u,l,\nb.csv,u,l,2020-02-29\n",
        "log,unit\nb.csv,u\n",
    ] {
        let (code, text) = run(units, "a.csv b.csv");
        assert_eq!(code, Some(0), "{text}");
    }
}

/// A process that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill().and_then(|()| self.0.wait());
    }
}

/// Dask on two workers, one of which is killed in the middle, gives the table of a run on one machine.
#[test]
fn dask_gives_the_same_rows_although_a_worker_dies() {
    let Some(python) = std::env::var_os("RETROFLEX_DASK_PYTHON") else {
        eprintln!("skipped: RETROFLEX_DASK_PYTHON names no Python with the package `distributed`");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    short_logs(folder);
    good(folder, "gap diagnose logs --rows all.parquet");
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let address = format!("tcp://127.0.0.1:{port}");
    let start = |args: &[&str]| {
        let mut command = Command::new(&python);
        command
            .args(args)
            .current_dir(folder)
            .env("RETROFLEX", env!("CARGO_BIN_EXE_retroflex"));
        Running(
            command
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        )
    };
    let _scheduler = start(&[
        "-m",
        "distributed.cli.dask_scheduler",
        "--port",
        &port.to_string(),
        "--no-dashboard",
    ]);
    let worker = || {
        start(&[
            "-m",
            "distributed.cli.dask_worker",
            &address,
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
        ])
    };
    let (mut first, _second) = (worker(), worker());
    let example = repo("examples/fleet_dask.py");
    let mut run = start(&[
        example.to_str().unwrap(),
        "logs",
        "dask.parquet",
        "--parts",
        "4",
        "--scheduler",
        &address,
    ]);
    // in the middle: some part has a row
    let parts = || (1..=4).map(|k| folder.join(format!("dask.{k}.parquet.journal")));
    let begun = Instant::now();
    while !parts()
        .any(|journal| std::fs::read_to_string(journal).is_ok_and(|text| text.lines().count() > 1))
    {
        assert!(
            begun.elapsed() < Duration::from_secs(120) && run.0.try_wait().unwrap().is_none(),
            "no part began"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    first.0.kill().unwrap();
    assert!(run.0.wait().unwrap().success());
    assert!(
        std::fs::read(folder.join("dask.parquet")).unwrap()
            == std::fs::read(folder.join("all.parquet")).unwrap()
    );
}

/// Rows of 1,000 sound units in four lots, 4 % of which have one of five effects.
fn fleet(rng: &mut StdRng) -> Vec<FleetRow> {
    let spread = Normal::new(0.0, 0.06).unwrap();
    let row = |n: usize| {
        let names = if rng.random_bool(0.04) {
            ["leak", "creep", "clocking", "gravity", "line_lag"][rng.random_range(0..5)]
        } else {
            ""
        };
        FleetRow {
            log: format!("{n:04}"),
            lot: ["A", "B", "C", "D"][n % 4].to_owned(),
            date: format!(
                "2026-{:02}-{:02}",
                rng.random_range(1..=12),
                rng.random_range(1..=28)
            ),
            verdict: if names.is_empty() { "none" } else { "effects" }.to_owned(),
            names: names.to_owned(),
            numbers: GAINS
                .iter()
                .map(|gain| ((*gain).to_owned(), 2.2 + spread.sample(rng)))
                .collect(),
            ..FleetRow::default()
        }
    };
    (0..1000).map(row).collect()
}

fn found(rows: &[FleetRow]) -> Vec<(String, Option<String>, bool)> {
    let mut found: Vec<_> = Survey::new(rows)
        .findings
        .into_iter()
        .map(|f| (f.what, f.lot, f.drifts))
        .collect();
    found.sort();
    found
}

/// Of 100 fleets whose lots do not differ, at most three show a difference: the level is one in a hundred.
#[test]
fn lots_that_do_not_differ_show_no_difference() {
    let mut rng = StdRng::seed_from_u64(1);
    let wrong = (0..100)
        .filter(|_| !found(&fleet(&mut rng)).is_empty())
        .count();
    assert!(wrong <= 3, "{wrong} of 100");
}

#[test]
fn every_planted_difference_is_found_and_no_other() {
    let mut rng = StdRng::seed_from_u64(2);
    let mut complete = 0;
    for _ in 0..20 {
        let mut rows = fleet(&mut rng);
        for row in &mut rows {
            let month: f64 = row.date[5..7].parse().unwrap();
            let (effect, share) = match row.lot.as_str() {
                "B" => ("leak", 0.25),
                "D" => ("line_lag", (month - 1.0) / 22.0),
                _ => ("", 0.0),
            };
            if rng.random_bool(share) {
                (row.verdict, row.names) = ("effects".to_owned(), effect.to_owned());
            }
            if row.lot == "C" {
                row.numbers
                    .entry("k_epsilon_2".to_owned())
                    .and_modify(|k| *k += 0.04);
            }
        }
        let lot = |what: &str, lot: &str, drifts| (what.to_owned(), Some(lot.to_owned()), drifts);
        let planted = [
            lot("k_epsilon_2", "C", false),
            lot("leak", "B", false),
            lot("line_lag", "D", false),
            lot("line_lag", "D", true),
        ];
        complete += usize::from(found(&rows) == planted);
    }
    assert!(complete >= 19, "{complete} of 20");
}

#[test]
fn rows_survive_a_table() {
    let mut all = fleet(&mut StdRng::seed_from_u64(3));
    all[0].numbers.remove("lag_s");
    all[1].refused = "no rows, \"quoted\" °".to_owned();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rows.parquet");
    std::fs::write(&path, columns::write(&table(&all), &[]).unwrap()).unwrap();
    assert_eq!(
        rows(&columns::read(std::fs::File::open(&path).unwrap()).unwrap()).unwrap(),
        all
    );
}
