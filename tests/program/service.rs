//! The service as a whole, from outside: real sockets, real time, the built-in plant.

use crate::common::tries;
use nix::sys::signal::Signal;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use retroflex::cli::flight::read;
use retroflex::drill::process::Daemon;
use retroflex::log::bend_log;
use retroflex::service::flight::cycle::{Cycle, FIELDS};
use retroflex::service::flight::file::FlightFile;
use retroflex::service::flight::read::{Ending, Entry};
use retroflex::service::flight::schema;
use retroflex::service::store::Store;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

/// Runs a command against a socket; returns its exit code and output.
fn cli(socket: &Path, args: &[&str]) -> (i32, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = Command::new(program())
        .args(args)
        .env("RETROFLEX_SOCKET", socket)
        .output()
        .unwrap();
    (
        status.code().unwrap(),
        String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr),
    )
}

#[track_caller]
fn expect(socket: &Path, args: &[&str], code: i32, part: &str) {
    let (got, text) = cli(socket, args);
    assert!(
        got == code && text.contains(part),
        "{args:?}: expected exit code {code} and `{part}`, got {got}:\n{text}"
    );
}

#[test]
fn a_session_from_start_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let socket = daemon.sockets()[0].clone();
    daemon
        .until(10.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();

    // it starts disarmed, and every refusal names the remedy
    expect(&socket, &["bend", "30"], 1, "arm");
    expect(&socket, &["record", "start", "../x"], 2, "not a valid name");

    // a recording that starts at rest can be replayed
    expect(&socket, &["record", "start", "day"], 0, "day.csv");
    expect(&socket, &["arm"], 0, "");
    expect(
        &socket,
        &["bend", "40", "--toward", "30", "--wait"],
        0,
        "settled",
    );
    let status = daemon.until(2.0, "status", |_| true).unwrap();
    // the service says whatever the command line reads
    let read = serde_json::to_value(retroflex::service::status::Status::default()).unwrap();
    for key in read.as_object().unwrap().keys() {
        assert!(status.get(key).is_some(), "{key}: {status}");
    }
    assert!(
        (status["estimate"]["bend_deg"].as_f64().unwrap() - 40.0).abs() < 1.0,
        "{status}"
    );
    expect(
        &socket,
        &["zero"],
        1,
        "not while holding: `retroflex relax` first",
    );

    // a stop brakes at once and latches until `arm`
    expect(
        &socket,
        &["bend", "10", "--toward", "-90", "--speed", "20"],
        0,
        "",
    );
    std::thread::sleep(Duration::from_millis(300));
    expect(&socket, &["stop"], 0, "");
    let status = daemon
        .until(2.0, "the stop", |s| {
            s["mode"] == "holding" && s["stopped"] == true
        })
        .unwrap();
    assert!(
        status["estimate"]["bend_deg"].as_f64().unwrap() > 20.0,
        "the tip was not stopped on its way: {status}"
    );
    expect(&socket, &["bend", "10"], 1, "retroflex arm");
    expect(&socket, &["relax"], 1, "retroflex arm");
    expect(&socket, &["arm"], 0, "");
    expect(&socket, &["relax"], 0, "");
    daemon
        .until(10.0, "rest", |s| {
            s["mode"] == "disarmed" && s["counted"] == serde_json::json!([0, 0, 0])
        })
        .unwrap();
    expect(&socket, &["record", "stop"], 0, "can be replayed");
    replays(&folder.path().join("state/recordings/day.csv.gz"));

    // the status socket is read-only
    let status_socket = folder.path().join("status.sock");
    expect(&status_socket, &["status", "--json"], 0, "disarmed");
    expect(&status_socket, &["arm"], 1, "read-only");
    expect(&status_socket, &["stop"], 1, "read-only");

    // what the tip cannot reach is refused before it moves, with what it can reach
    expect(&socket, &["bend", "110"], 2, "at most 8");
    // a schedule moves the tip, so it is not played before `arm`
    let schedule = folder.path().join("schedule.csv");
    std::fs::write(
        &schedule,
        "bend_deg,dir_deg,len_mm,hold_s,speed_mm_s\n0,0,20,4,5\n20,0,20,0.1,20\n",
    )
    .unwrap();
    expect(
        &socket,
        &["play", schedule.to_str().unwrap()],
        1,
        "retroflex arm",
    );

    // it ends at rest, and the memory says so
    let (success, _) = daemon.end().unwrap();
    assert!(success, "the service did not end with success");
    let (_, recall) = Store::open(&folder.path().join("state")).unwrap();
    let memory = recall.memory.unwrap();
    assert!(!memory.armed && memory.restart.unwrap().steps.0 == [0; 3]);
    expect(&socket, &["status"], 3, "");
}

/// In mid-motion, one service a signal.
#[test]
#[allow(unsafe_code)]
fn every_signal_that_ends_a_process_returns_the_tip_to_rest() {
    let signals = [Signal::SIGHUP, Signal::SIGQUIT, Signal::SIGUSR1];
    for signal in signals {
        // a service leaves a signal ignored that its caller ignores, as the shell of a job in the background does
        // SAFETY: no handler of this process is replaced
        unsafe { nix::sys::signal::signal(signal, nix::sys::signal::SigHandler::SigDfl) }.unwrap();
    }
    std::thread::scope(|scope| {
        for signal in signals {
            scope.spawn(move || {
                let folder = tempfile::tempdir().unwrap();
                let daemon = Daemon::start(program(), folder.path()).unwrap();
                daemon.take_off().unwrap();
                std::thread::sleep(std::time::Duration::from_millis(300));
                let (success, time_s) = daemon.end_by(signal).unwrap();
                let log = std::fs::read_to_string(folder.path().join("log")).unwrap();
                assert!(success, "signal {signal}, after {time_s} s: {log}");
                let (_, recall) = Store::open(&folder.path().join("state")).unwrap();
                let memory = recall.memory.unwrap();
                let steps = memory.restart.unwrap().steps.0;
                assert!(
                    !memory.armed && steps == [0; 3],
                    "signal {signal}: {steps:?}"
                );
            });
        }
    });
}

#[test]
fn commands_that_wait_end_and_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let socket = &daemon.sockets()[0].clone();
    // the service has just been started
    expect(socket, &["arm"], 0, "alignment");
    for (other, part) in [
        (&["bend", "10"][..], "another command"),
        (&["hold"], "another command"),
        (&["stop"], "stopped"),
    ] {
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| cli(socket, &["bend", "-60", "--speed", "15", "--wait"]));
            std::thread::sleep(Duration::from_millis(800));
            expect(socket, other, 0, "");
            let (code, text) = waiting.join().unwrap();
            assert!(
                code == 1 && text.contains(part),
                "{other:?}: {code}: {text}"
            );
        });
    }
    expect(socket, &["arm"], 0, "");
    expect(
        socket,
        &["bend", "-20", "--wait"],
        0,
        "20.0° at 180°: settled",
    );

    let mut watching = Command::new("timeout");
    watching
        .args(["20", program().to_str().unwrap(), "status", "--watch"])
        .env("RETROFLEX_SOCKET", socket);
    let mut watching = watching
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(watching.stdout.take());
    assert!(
        watching.wait().unwrap().success(),
        "nobody reads the status any more"
    );

    daemon.signal(Signal::SIGSTOP);
    let since = Instant::now();
    expect(socket, &["stop"], 3, "cut the power of its motors");
    expect(socket, &["status"], 3, "does not answer");
    assert!(
        since.elapsed() < Duration::from_secs(6),
        "{:?}",
        since.elapsed()
    );
    daemon.signal(Signal::SIGCONT);
}

/// A command without a service; returns its exit code and output.
fn offline(args: &[&Path]) -> (i32, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = Command::new(program()).args(args).output().unwrap();
    (
        status.code().unwrap(),
        String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr),
    )
}

/// The recording is an ordinary bend log, its replay makes the same decisions, and one changed bit is found and named.
fn replays(log: &Path) {
    let read = bend_log::read(log).unwrap();
    assert!(read.ignored.is_empty() && read.t_s.len() > 1000 && read.imu.is_some());
    let replay = |path: &Path| offline(&[Path::new("replay"), path]);
    let (code, text) = replay(log);
    assert!(
        code == 0 && text.contains(" 0 differ") && !text.contains("gap"),
        "{text}"
    );
    let flight = log.with_file_name("day.mcap");
    assert_eq!(replay(&flight).0, 0);

    // the exported bend log has the rows of the recording, the last ones of which may come after its end
    let exported = log.with_file_name("exported.csv");
    let (code, text) = offline(&[
        Path::new("log"),
        Path::new("export"),
        &flight,
        Path::new("--csv"),
        &exported,
    ]);
    assert_eq!(code, 0, "{text}");
    let again = bend_log::read(&exported).unwrap();
    let rows = again.t_s.len().min(read.t_s.len());
    assert!(
        rows > 1000
            && again.t_s[..rows] == read.t_s[..rows]
            && again.piston_mm[..rows] == read.piston_mm[..rows]
    );

    // not every cycle carries the digests of its fields
    let changed = log.with_file_name("changed.mcap");
    let at = FIELDS.iter().position(|name| *name == "feedback").unwrap();
    let mut altered = 0;
    rewrite(&flight, &changed, &mut |number, cycle| {
        if let (true, true, Some(digest)) =
            (number > 3000, altered < 10, cycle.digests.1.get_mut(at))
        {
            *digest ^= 1;
            altered += 1;
        }
        true
    });
    assert_eq!(altered, 10);
    let (code, text) = replay(&changed);
    assert!(
        code == 1 && text.contains("in feedback:") && text.contains("the software has changed"),
        "{text}"
    );

    let gapped = log.with_file_name("gapped.mcap");
    rewrite(&flight, &gapped, &mut |number, _| {
        !(3000..3100).contains(&number)
    });
    let (code, text) = replay(&gapped);
    assert!(
        code == 0
            && text.contains("gap: 100 cycles are missing")
            && !text.contains("software has changed"),
        "{text}"
    );
    let (code, text) = offline(&[Path::new("log"), Path::new("info"), &gapped]);
    assert!(code == 0 && text.contains("gap: 100 cycles"), "{text}");

    // a cut from the start can be replayed, one without it is refused
    let cut = log.with_file_name("cut.mcap");
    let (code, text) = offline(
        &[
            "log",
            "cut",
            flight.to_str().unwrap(),
            "--to",
            "3",
            "--out",
            cut.to_str().unwrap(),
        ]
        .map(Path::new),
    );
    assert_eq!(code, 0, "{text}");
    let (code, text) = replay(&cut);
    assert!(code == 0 && text.contains(" 0 differ"), "{text}");
    let late = log.with_file_name("late.mcap");
    let (code, text) = offline(
        &[
            "log",
            "cut",
            flight.to_str().unwrap(),
            "--from",
            "3",
            "--out",
            late.to_str().unwrap(),
        ]
        .map(Path::new),
    );
    assert_eq!(code, 0, "{text}");
    let (code, text) = replay(&late);
    assert!(code == 2 && text.contains("cannot be replayed"), "{text}");

    // other gains change something, and the answer says that it is speculation
    let gains = log.with_file_name("gains.toml");
    std::fs::write(&gains, "[loop]\nki_1_s = 2.0\n").unwrap();
    let (code, text) = offline(&[Path::new("replay"), &flight, Path::new("--gains"), &gains]);
    assert!(
        code == 0 && text.contains("speculation") && text.contains("feedback"),
        "{text}"
    );
}

/// Copies the cycles of a log that `keep` accepts, as `keep` changes them.
fn rewrite(from: &Path, to: &Path, keep: &mut dyn FnMut(u64, &mut Cycle) -> bool) {
    let mut file = FlightFile::create(to, 0).unwrap();
    let ending = read(from, &mut |_, message| {
        let Entry::Cycles(first, cycles) = Entry::of(message)? else {
            file.copy(message).unwrap();
            return Ok(());
        };
        let mut run: (u64, Vec<Cycle>) = (first, vec![]);
        let mut put = |run: &(u64, Vec<Cycle>)| {
            if !run.1.is_empty() {
                file.write_cycles(run.0, &run.1, message.log_time).unwrap();
            }
        };
        for (number, mut cycle) in (first..).zip(cycles) {
            if keep(number, &mut cycle) {
                run.1.push(cycle);
            } else {
                put(&run);
                run = (number + 1, vec![]);
            }
        }
        put(&run);
        Ok(())
    });
    assert_eq!(ending.unwrap(), Ending::COMPLETE);
    file.finish().unwrap();
}

/// The newest flight log of a service.
fn flight(folder: &Path) -> PathBuf {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder.join("state/flights"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    all.sort();
    all.pop().unwrap()
}

/// Kills a service after a time; its log then ends less than a second before, and replays. The tip moves if there is time for it.
fn kill_after(after: Duration) {
    let (folder, began) = (tempfile::tempdir().unwrap(), Instant::now());
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let socket = daemon.sockets()[0].clone();
    if after > Duration::from_secs(2) {
        daemon
            .until(10.0, "alignment", |s| s["mode"] == "disarmed")
            .unwrap();
        expect(&socket, &["arm"], 0, "");
        expect(&socket, &["bend", "40"], 0, "");
    }
    std::thread::sleep(after.saturating_sub(began.elapsed()));
    let status = daemon.until(2.0, "status", |s| s["t"].is_number()).unwrap();
    daemon.kill();
    let mut last_s = 0.0;
    let ending = read(&flight(folder.path()), &mut |_, message| {
        if let Entry::Cycles(_, cycles) = Entry::of(message)? {
            last_s = cycles.last().map_or(last_s, |c| c.sensed.t.0);
        }
        Ok(())
    });
    let ending = ending.unwrap().to_string();
    assert!(ending.contains("last whole chunk"), "{after:?}: {ending}");
    assert!(
        last_s > status["t"].as_f64().unwrap() - 1.0,
        "{after:?}: {last_s} s of {}",
        status["t"]
    );
    let (code, text) = offline(&[Path::new("replay"), &flight(folder.path())]);
    assert!(
        code == 0 && text.contains(" 0 differ") && text.contains("last whole chunk"),
        "{after:?}: {text}"
    );
}

#[test]
fn services_killed_at_random_leave_logs_to_their_last_second_that_replay() {
    let mut rng = StdRng::seed_from_u64(17);
    let kills: Vec<Duration> = (0..10 * tries())
        .map(|_| Duration::from_secs_f64(rng.random_range(1.0..5.0)))
        .collect();
    for some in kills.chunks(5) {
        std::thread::scope(|scope| {
            some.iter()
                .for_each(|after| drop(scope.spawn(|| kill_after(*after))))
        });
    }
}

#[test]
fn files_rotate_stay_bounded_and_replay_as_a_series() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    std::fs::write(&board, "base = \"sim\"\n[service]\nflight_file_s = 2.0\nflight_file_mib = 1.0\nflight_max_mib = 64.0\n").unwrap();
    let daemon = Daemon::start_with(
        program(),
        folder.path(),
        &["--board", board.to_str().unwrap(), "--fast", "4"],
    )
    .unwrap();
    let socket = daemon.sockets()[0].clone();
    daemon
        .until(10.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();
    expect(&socket, &["arm"], 0, "");
    expect(&socket, &["bend", "40", "--wait"], 0, "settled");
    daemon
        .until(10.0, "some files", |s| s["t"].as_f64().unwrap() > 20.0)
        .unwrap();
    assert!(daemon.end().unwrap().0);
    let last = flight(folder.path());
    let part = last
        .to_str()
        .unwrap()
        .split('-')
        .next_back()
        .unwrap()
        .to_owned();
    assert!(part.as_str() > "003.mcap", "{part}");
    let (code, text) = offline(&[Path::new("replay"), &last]);
    assert!(
        code == 0 && text.contains(" 0 differ") && !text.contains("gap"),
        "{text}"
    );
    // without its beginning it cannot be replayed
    std::fs::remove_file(last.with_file_name("flight-000001-001.mcap")).unwrap();
    let (code, text) = offline(&[Path::new("replay"), &last]);
    assert!(code == 2 && text.contains("cannot be replayed"), "{text}");
}

/// The official packages for Python, if they are installed, decode every message of all parts of a run, whose schemas are the same, and
/// find every checksum in order.
#[test]
fn the_official_reader_decodes_a_run() {
    let python = std::env::var("RETROFLEX_MCAP_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if !Command::new(&python)
        .args(["-c", "import mcap_protobuf"])
        .output()
        .is_ok_and(|out| out.status.success())
    {
        eprintln!("skipped: {python} has no packages `mcap` and `mcap-protobuf-support`");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    std::fs::write(&board, "base = \"sim\"\n[service]\nflight_file_s = 5.0\n").unwrap();
    let daemon = Daemon::start_with(
        program(),
        folder.path(),
        &["--board", board.to_str().unwrap(), "--fast", "10"],
    )
    .unwrap();
    let socket = daemon.sockets()[0].clone();
    daemon
        .until(10.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();
    expect(&socket, &["arm"], 0, "");
    expect(&socket, &["bend", "40", "--wait"], 0, "settled");
    daemon
        .until(10.0, "parts", |s| s["t"].as_f64().unwrap() > 12.0)
        .unwrap();
    assert!(daemon.end().unwrap().0);
    let last = flight(folder.path());
    let mut parts: Vec<PathBuf> = std::fs::read_dir(last.parent().unwrap())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    parts.sort();
    assert!(parts.len() > 1, "{parts:?}");
    let out = Command::new(&python)
        .arg("tests/program/read_mcap.py")
        .args(&parts)
        .output()
        .unwrap();
    let text =
        String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{text}");
    let topics = schema::TOPICS.map(|(topic, _)| topic);
    for part in topics.iter().chain(&["board.toml", "calibration.toml"]) {
        assert!(text.contains(part), "{part} is missing: {text}");
    }
}

#[test]
fn a_second_service_with_the_same_state_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let other = Command::new(program())
        .args(["run", "--socket"])
        .arg(folder.path().join("other.sock"))
        .arg("--state")
        .arg(folder.path().join("state"))
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&other.stderr).into_owned();
    assert!(
        other.status.code() == Some(2) && text.contains("another retroflex"),
        "{text}"
    );
    daemon.end().unwrap();
}

/// Without flags, an ordinary user's service and commands find each other; damaged memory is lost until an asserted zero.
#[test]
fn an_ordinary_user_needs_no_flags_and_a_simulated_plant_begins_at_rest() {
    let folder = tempfile::tempdir().unwrap();
    let command = |args: &[&str]| {
        let mut command = Command::new(program());
        // as root the system's folders would be used; systemd's variables stand for the user's here
        command
            .args(args)
            .env("STATE_DIRECTORY", folder.path().join("state"))
            .env("RUNTIME_DIRECTORY", folder.path().join("run"));
        command
            .env_remove("RETROFLEX_SOCKET")
            .env_remove("NOTIFY_SOCKET")
            .env_remove("JOURNAL_STREAM");
        command
    };
    let status = || {
        let out = command(&["status", "--json"]).output().unwrap();
        serde_json::from_slice::<serde_json::Value>(&out.stdout).unwrap_or_default()
    };
    let until = |mode: &str| {
        let since = Instant::now();
        while status()["mode"] != mode {
            assert!(
                since.elapsed() < Duration::from_secs(20),
                "{mode}: {}",
                status()
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    let memory = folder.path().join("state/memory.b");
    // a kill in motion concerns the pistons of a real machine only; a damaged memory is doubted whatever the machine
    for damage in [None, None, Some(0), Some(1000), Some(32_767)] {
        if let Some(length) = damage {
            let whole = std::fs::read(&memory).unwrap();
            std::fs::write(&memory, &whole[..length]).unwrap();
        }
        let mut child = command(&["run"])
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        if damage.is_some() {
            until("lost");
            let lost = status()["lost"].to_string();
            assert!(lost.contains("memory.b"), "{lost}");
            assert!(
                command(&["zero", "--straight"])
                    .output()
                    .unwrap()
                    .status
                    .success()
            );
        }
        until("disarmed");
        assert_eq!(status()["counted"], serde_json::json!([0, 0, 0]));
        for args in [&["arm"][..], &["bend", "40", "--wait"]] {
            let out = command(args).output().unwrap();
            assert!(
                out.status.success(),
                "{args:?}: {}",
                String::from_utf8_lossy(&out.stderr)
            );
        }
        child.kill().unwrap();
        child.wait().unwrap();
    }
}

/// A board that describes no machine, plants that end at once, and a start that is killed at any instant: none is damage to the memory.
#[test]
fn a_start_after_one_that_failed_is_not_lost() {
    let folder = tempfile::tempdir().unwrap();
    let (state, board) = (folder.path().join("state"), folder.path().join("bad.toml"));
    std::fs::write(&board, "").unwrap();
    let start = |args: &[&str]| {
        let mut command = Command::new(program());
        command
            .args(["run", "--socket"])
            .arg(folder.path().join("control.sock"));
        command
            .arg("--state")
            .arg(&state)
            .args(args)
            .stderr(Stdio::null());
        command
    };
    let board = ["--board", board.to_str().unwrap()];
    for bad in [
        board,
        ["--plant", "exec:false"],
        ["--plant", "exec:/nowhere"],
    ] {
        let code = start(&bad).status().unwrap().code();
        assert!(matches!(code, Some(2 | 3)), "{bad:?}: {code:?}");
    }
    let mut rng = StdRng::seed_from_u64(5);
    for n in 0..20 {
        if n % 2 == 0 {
            let _ = std::fs::remove_dir_all(&state);
        }
        let mut child = start(&[]).spawn().unwrap();
        std::thread::sleep(Duration::from_micros(rng.random_range(0..60_000)));
        child.kill().unwrap();
        child.wait().unwrap();
        if state.join("lock").exists() {
            let recall = Store::open(&state).unwrap().1;
            assert_eq!(recall.damaged, Vec::<String>::new(), "start {n}");
        }
    }
    let _ = std::fs::remove_dir_all(&state);
    start(&board).status().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let located = |s: &serde_json::Value| s["mode"] == "disarmed" && s["lost"].is_null();
    daemon.until(10.0, "alignment", located).unwrap();
    daemon.end().unwrap();
}

/// Every command that prints something, to a disk that is full and to a reader that is gone.
#[test]
fn an_answer_that_cannot_be_printed_is_no_success() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let [socket, ..] = daemon.sockets();
    let run = |args: &[&str], to: Stdio| {
        let mut command = Command::new(program());
        command
            .args(args)
            .env("RETROFLEX_SOCKET", socket)
            .stdout(to);
        let out = command.stderr(Stdio::piped()).output().unwrap();
        (
            out.status.code(),
            String::from_utf8_lossy(&out.stderr).into_owned(),
        )
    };
    for args in [
        &["status"][..],
        &["status", "--json", "-"],
        &["status", "--json", "/dev/stdout"],
        &["status", "--watch"],
        &["subscribe"],
        &["--help"],
        &["help", "bend"],
        &["--version"],
        &["completions", "bash"],
        &["board", "show", "sim"],
    ] {
        let full = std::fs::File::options()
            .write(true)
            .open("/dev/full")
            .unwrap();
        let (code, text) = run(args, full.into());
        assert!(
            code == Some(2) && text.contains("No space left on device"),
            "{args:?}: {code:?} {text}"
        );
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        if !args.contains(&"/dev/stdout") {
            assert_eq!(
                run(args, writer.into()),
                (Some(0), String::new()),
                "{args:?}"
            );
        }
    }
    daemon.end().unwrap();
}

/// Without room for them no log is written, the status and the refusal of a recording say why, and files in the way are refused.
#[test]
fn a_full_disk_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    std::fs::write(&board, "base = \"sim\"\n[service]\nrecord_free_mib = 1e6\n").unwrap();
    let daemon = Daemon::start_with(
        program(),
        folder.path(),
        &["--board", board.to_str().unwrap()],
    )
    .unwrap();
    let problem = |s: &serde_json::Value| {
        s["flight_log"]["problem"]
            .as_str()
            .is_some_and(|why| why.contains("record_free_mib"))
    };
    let status = daemon.until(5.0, "the problem", problem).unwrap();
    assert_eq!(status["flight_log"]["writing"], false);
    let socket = daemon.sockets()[0].clone();
    expect(&socket, &["status"], 0, "record_free_mib");
    expect(&socket, &["record", "start", "x"], 1, "record_free_mib");
    for file in [&board, &board.join("x.csv")] {
        let out = Command::new(program())
            .args(["run", "--board", "sim", "--record"])
            .arg(file)
            .output()
            .unwrap();
        assert!(
            out.status.code() == Some(2)
                && String::from_utf8_lossy(&out.stderr).contains("--record"),
            "{file:?}: {out:?}"
        );
    }
}

/// A recording ends at its limit and says so; an armed tip that nobody commands returns to rest after `hold_max_s`.
#[test]
fn limits_end_a_hold_and_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let (board, socket) = (
        folder.path().join("board.toml"),
        folder.path().join("control.sock"),
    );
    std::fs::write(
        &board,
        "base = \"sim\"\n[service]\nhold_max_s = 4.0\nrecord_max_s = 1.5\n",
    )
    .unwrap();
    let mut child = Command::new(program())
        .args(["run", "--board"])
        .arg(&board)
        .arg("--socket")
        .arg(&socket)
        .arg("--state")
        .arg(folder.path().join("state"))
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let until = |what: &str, holds: &dyn Fn(&serde_json::Value) -> bool| {
        let since = Instant::now();
        loop {
            let (_, text) = cli(&socket, &["status", "--json"]);
            let status = serde_json::from_str(&text).unwrap_or_default();
            if holds(&status) {
                return status;
            }
            assert!(since.elapsed() < Duration::from_secs(20), "{what}: {text}");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    until("alignment", &|s| s["mode"] == "disarmed");
    expect(&socket, &["record", "start", "x"], 0, "");
    let status = until("the limit", &|s| s["recording"].is_null());
    assert!(
        status["recording_ended"]
            .as_str()
            .unwrap()
            .contains("record_max_s"),
        "{status}"
    );
    let mut log = String::new();
    let file = std::fs::File::open(folder.path().join("state/recordings/x.csv.gz")).unwrap();
    flate2::read::GzDecoder::new(file)
        .read_to_string(&mut log)
        .unwrap();
    let width = |line: &str| line.split(',').count();
    let (header, rows) = log.split_once('\n').unwrap();
    assert!(
        header.contains("temp_c,pressure1_kpa,pressure2_kpa,pressure3_kpa,base_acc_x_m_s2"),
        "{header}"
    );
    assert!(rows.lines().count() > 100 && rows.lines().all(|row| width(row) == width(header)));

    until("alignment", &|s| s["mode"] == "disarmed");
    expect(&socket, &["arm"], 0, "");
    expect(&socket, &["bend", "20", "--wait"], 0, "settled");
    until("rest", &|s| {
        s["mode"] == "disarmed" && s["energised"] == false
    });
    child.kill().unwrap();
    child.wait().unwrap();
}
