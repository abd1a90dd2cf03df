//! Several clients of one service, and what it refuses, reads and says.

use retroflex::config::shipped;
use retroflex::drill::process::Daemon;
use retroflex::service::protocol::{PathRow, Request};
use retroflex::service::{LearnedGains, Memory, Store};
use serde_json::Value;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

/// Runs a command against a service; returns its exit code and output.
fn cli(daemon: &Daemon, args: &[&str]) -> (i32, String) {
    let out = Command::new(program())
        .args(args)
        .env("RETROFLEX_SOCKET", &daemon.sockets()[0])
        .output()
        .unwrap();
    let said = [out.stdout, out.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    (out.status.code().unwrap(), said.concat())
}

#[track_caller]
fn expect(daemon: &Daemon, args: &[&str], code: i32, part: &str) {
    let (got, text) = cli(daemon, args);
    assert!(
        got == code && text.contains(part),
        "{args:?}: expected exit code {code} and `{part}`, got {got}:\n{text}"
    );
}

/// Arms the tip, and waits until it may move.
fn arm(daemon: &Daemon) {
    expect(daemon, &["arm"], 0, "");
    let energised = |s: &Value| s["energised"] == true;
    daemon.until(5.0, "energised drivers", energised).unwrap();
}

fn is_holding(s: &Value) -> bool {
    s["mode"] == "holding"
}

/// Every kind of command from another client, in the middle of a path and of a schedule.
#[test]
fn what_another_command_ends_was_not_played_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let options = ["--board", "sim", "--fast", "4"];
    let daemon = Daemon::start_with(program(), folder.path(), &options).unwrap();
    arm(&daemon);
    let file = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name).display().to_string()
    };
    let path = file("path.csv", "t_s,bend_deg,dir_deg\n0,0,0\n4,40,0\n");
    let schedule = "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n40,0,20,1,3\n";
    let schedule = file("schedule.csv", schedule);
    let rows: Vec<PathRow> = vec![(0.0, 0.0, 90.0, None), (1.0, 10.0, 90.0, None)];
    let others = [
        Request::Hold {},
        Request::bend(10.0, 90.0, None, None),
        Request::stream(10.0, 90.0, None),
        Request::stream(10.0, 90.0, Some(7.0)),
        Request::Path { rows, more: false },
    ];
    let on_the_path = |s: &Value| s["path"]["at_s"].as_f64().is_some_and(|at_s| at_s > 0.5);
    let on_the_way = |s: &Value| s["mode"] == "tracking";
    type Begun<'a> = &'a dyn Fn(&Value) -> bool;
    let plays: [(&str, Begun<'_>); 2] = [
        (path.as_str(), &on_the_path),
        (schedule.as_str(), &on_the_way),
    ];
    for (file, is_under_way) in plays {
        for other in &others {
            let mut client = daemon.client().unwrap();
            std::thread::scope(|scope| {
                let playing = scope.spawn(|| cli(&daemon, &["play", file]));
                daemon.until(15.0, file, is_under_way).unwrap();
                std::thread::sleep(Duration::from_millis(50));
                client.request(other).unwrap();
                let (code, text) = playing.join().unwrap();
                assert!(
                    code == 1 && text.contains("another command ended it"),
                    "{file}, {other:?}: {code}: {text}"
                );
            });
            daemon.until(15.0, "a rest", is_holding).unwrap();
        }
    }
    for file in [path.as_str(), schedule.as_str()] {
        expect(&daemon, &["play", file], 0, "");
    }
}

#[test]
fn connections_share_neither_the_rows_of_a_path_nor_the_clock_of_a_stream() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    std::fs::write(&board, "base = \"sim\"\n[service]\ndead_man_s = 1.0\n").unwrap();
    let given = ["--board", board.to_str().unwrap()];
    let daemon = Daemon::start_with(program(), folder.path(), &given).unwrap();
    arm(&daemon);
    let mut clients = [0, 1].map(|_| daemon.client().unwrap());
    let rows = |from: u32| -> Vec<PathRow> {
        let row = |k: u32| (f64::from(k) * 0.1, f64::from(k), 0.0, None);
        (from..from + 10).map(row).collect()
    };
    for (client, from, more) in [(0, 0, true), (1, 5, true), (0, 10, false), (1, 15, false)] {
        let rows = rows(from);
        let answer = clients[client].request(&Request::Path { rows, more });
        let answer = answer.unwrap();
        let [duration_s, scale] = ["duration_s", "time_scale"].map(|key| answer[key].as_f64());
        let duration_s = duration_s.zip(scale).map(|(s, scale)| s / scale);
        assert!(
            more || duration_s.is_some_and(|s| (s - 1.9).abs() < 1e-6),
            "{answer}"
        );
    }
    // each on its own clock, and within it in order
    for (client, t_s) in [(0, 50.0), (1, 0.0), (1, 0.02), (0, 50.1), (1, 0.04)] {
        let set_point = Request::stream(5.0, 0.0, Some(t_s));
        clients[client].request(&set_point).unwrap();
    }
    for t_s in [0.04, 0.03, -5.0, -1e9] {
        let set_point = Request::stream(5.0, 0.0, Some(t_s));
        let refused = clients[1].request(&set_point).unwrap_err();
        assert!(
            refused.code == 2 && refused.message.contains("must increase"),
            "{t_s}: {refused:?}"
        );
    }
}

#[test]
fn what_is_refused_is_named_with_its_place_its_range_and_its_mend() {
    let folder = tempfile::tempdir().unwrap();
    let gains = folder.path().join("gains.toml");
    std::fs::write(&gains, shipped::GAINS.1).unwrap();
    let given = ["--board", "sim", "--gains", gains.to_str().unwrap()];
    let daemon = Daemon::start_with(program(), folder.path(), &given).unwrap();
    arm(&daemon);
    expect(&daemon, &["reload"], 0, "is in use");

    // nothing that may never end is read
    for kind in ["pipe", "device", "socket", "folder"] {
        std::fs::remove_file(&gains).unwrap();
        match kind {
            "pipe" => assert!(
                Command::new("mkfifo")
                    .arg(&gains)
                    .status()
                    .unwrap()
                    .success()
            ),
            "device" => std::os::unix::fs::symlink("/dev/zero", &gains).unwrap(),
            "socket" => drop(UnixListener::bind(&gains).unwrap()),
            _ => std::fs::create_dir(&gains).unwrap(),
        }
        expect(&daemon, &["reload"], 2, "no regular file");
        expect(&daemon, &["status"], 0, "holding");
    }

    for (length, part) in [("5", "length_mm: 5 mm is outside"), ("200", "200 mm")] {
        expect(&daemon, &["bend", "30", "--length", length], 2, part);
    }
    let path = folder.path().join("path.csv");
    for (row, part) in [
        (
            "1,20,0,500",
            "line 3, column len_mm: `500.0` is not a number from",
        ),
        (
            "1,20,0,5",
            "line 3, column len_mm: `5.0` is not a number from",
        ),
        (
            "1,20,1e9,20",
            "line 3, column dir_deg: `1000000000.0` is not a number from -36000",
        ),
        (
            "1e-300,20,0,20",
            "line 3, column t_s: `1e-300` is not a number from",
        ),
        (
            "4000,20,0,20",
            "line 3, column t_s: `4000.0` is not a number from",
        ),
        (
            "1,130,0,20",
            "line 3, column bend_deg: `130` is not within reach",
        ),
    ] {
        let text = format!("t_s,bend_deg,dir_deg,len_mm\n0,20,0,20\n{row}\n");
        std::fs::write(&path, text).unwrap();
        expect(&daemon, &["play", path.to_str().unwrap()], 2, part);
    }

    // a recording that was refused has not ended
    expect(&daemon, &["record", "start", "kk"], 0, "kk.csv.gz");
    expect(&daemon, &["record", "stop"], 0, "rows");
    expect(&daemon, &["record", "start", "kk"], 1, "give another name");
    let status = daemon.until(2.0, "status", |_| true).unwrap();
    assert!(status["recording_ended"].is_null(), "{status}");
}

/// Both files of the memory, damaged in several ways: what the status offers works, and nothing else is accepted.
#[test]
fn a_lost_service_offers_what_ends_that() {
    for bytes in [0, 1, 32_768, 40_000] {
        let damage = "x".repeat(bytes);
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("state");
        std::fs::create_dir(&state).unwrap();
        for name in ["memory.a", "memory.b"] {
            std::fs::write(state.join(name), &damage).unwrap();
        }
        let options = ["--board", "sim", "--fast", "8"];
        let daemon = Daemon::start_with(program(), folder.path(), &options).unwrap();
        let lost = daemon.until(15.0, "lost", |s| s["mode"] == "lost").unwrap();
        let lost = lost["lost"].as_str().unwrap();
        assert!(
            lost.contains("`retroflex zero --straight`")
                && !lost.contains("`retroflex relax`")
                && !lost.contains("or more"),
            "{lost}"
        );
        expect(&daemon, &["relax"], 1, "no steps are remembered");
        expect(&daemon, &["zero"], 1, "zero --straight");
        expect(&daemon, &["zero", "--straight"], 0, "");
        daemon
            .until(15.0, "alignment", |s| s["mode"] == "disarmed")
            .unwrap();
    }
}

/// A memory with an accepted calibration of tip A, and calibration files of that tip, of another one, and of none.
#[test]
fn the_status_names_the_calibration_in_use() {
    for (tip, outranked) in [(Some("A"), true), (Some("B"), false), (None, false)] {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = Store::open(&folder.path().join("state")).unwrap();
        let gains = LearnedGains {
            k_epsilon: [2.3; 3],
            k_lambda_mm: [0.8; 3],
            lag_s: 0.03,
            delay_s: 0.01,
            tip: "A".to_owned(),
            unix_s: 0.0,
            source: "calibrate transmission".to_owned(),
        };
        let memory = Memory {
            accepted: Some(gains),
            ..Memory::default()
        };
        store.write(&memory).unwrap();
        drop(store);
        let tip_line = tip.map_or(String::new(), |tip| format!("tip = \"{tip}\""));
        let text = shipped::PAPER.1;
        let [found, origin] = ["tip = ", "source = "].map(|key| {
            let line = text.lines().find(|line| line.starts_with(key));
            line.unwrap()
        });
        let text = text.replace(found, &tip_line);
        let text = text.replace(origin, "source = \"a file\"");
        let calib = folder.path().join("calib.toml");
        std::fs::write(&calib, text).unwrap();
        let given = ["--board", "sim", "--calib", calib.to_str().unwrap()];
        let daemon = Daemon::start_with(program(), folder.path(), &given).unwrap();
        let status = daemon.until(15.0, "a status", |s| s["k_epsilon"].is_array());
        let status = status.unwrap();
        let named = ["a file", "calibrate transmission"][usize::from(outranked)];
        assert_eq!(status["calibration"], named, "{tip:?}: {status}");
        let in_use = status["k_epsilon"][0].as_f64().unwrap();
        assert_eq!((in_use - 2.3).abs() < 1e-3, outranked, "{tip:?}: {in_use}");
        assert!(status["feedforward"].is_null() && status["ending"] == false);
        let log = std::fs::read_to_string(folder.path().join("log")).unwrap();
        assert_eq!(log.contains("outranks"), outranked, "{tip:?}: {log}");
        // the memory names no tip
        assert!(!log.contains("another tip"), "{tip:?}: {log}");
    }
}
