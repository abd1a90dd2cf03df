//! The service as a whole, from outside: real sockets, real time, the built-in plant.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use retroflex::drill::process::Daemon;
use retroflex::log::bend_log;
use retroflex::service::protocol::{Request, request_line};
use retroflex::service::store::Store;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

/// Runs a command against a socket; returns its exit code and output.
fn cli(socket: &Path, args: &[&str]) -> (i32, String) {
    let Output { status, stdout, stderr } = Command::new(program()).args(args).env("RETROFLEX_SOCKET", socket).output().unwrap();
    (status.code().unwrap(), String::from_utf8_lossy(&stdout).into_owned() + &String::from_utf8_lossy(&stderr))
}

#[track_caller]
fn expect(socket: &Path, args: &[&str], code: i32, part: &str) {
    let (got, text) = cli(socket, args);
    assert!(got == code && text.contains(part), "{args:?}: expected exit code {code} and `{part}`, got {got}:\n{text}");
}

#[test]
fn a_session_from_start_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    let socket = daemon.socket().to_owned();
    daemon.until(10.0, "alignment", |s| s["mode"] == "disarmed").unwrap();

    // it starts disarmed, and every refusal names the remedy
    expect(&socket, &["bend", "30"], 1, "arm");
    expect(&socket, &["record", "start", "../x"], 2, "not a valid name");

    // a recording that starts at rest can be replayed
    expect(&socket, &["record", "start", "day"], 0, "day.csv");
    expect(&socket, &["arm"], 0, "");
    expect(&socket, &["bend", "40", "--toward", "30", "--wait"], 0, "settled");
    let status = daemon.until(2.0, "status", |_| true).unwrap();
    assert!((status["estimate"]["bend_deg"].as_f64().unwrap() - 40.0).abs() < 1.0, "{status}");

    // a stop brakes at once and latches until `arm`
    expect(&socket, &["bend", "10", "--toward", "-90", "--speed", "20"], 0, "");
    std::thread::sleep(Duration::from_millis(300));
    expect(&socket, &["stop"], 0, "");
    let status = daemon.until(2.0, "the stop", |s| s["mode"] == "holding" && s["stopped"] == true).unwrap();
    assert!(status["estimate"]["bend_deg"].as_f64().unwrap() > 20.0, "the tip was not stopped on its way: {status}");
    expect(&socket, &["bend", "10"], 1, "retroflex arm");
    expect(&socket, &["relax"], 1, "retroflex arm");
    expect(&socket, &["arm"], 0, "");
    expect(&socket, &["relax"], 0, "");
    daemon.until(10.0, "rest", |s| s["mode"] == "disarmed" && s["counted"] == serde_json::json!([0, 0, 0])).unwrap();
    expect(&socket, &["record", "stop"], 0, "can be replayed");
    replays(&folder.path().join("state/recordings/day.csv"));

    // the status socket is read-only
    let status_socket = folder.path().join("status.sock");
    expect(&status_socket, &["status", "--json"], 0, "disarmed");
    expect(&status_socket, &["arm"], 1, "read-only");
    expect(&status_socket, &["stop"], 1, "read-only");

    // it ends at rest, and the memory says so
    let (success, _) = daemon.end().unwrap();
    assert!(success, "the service did not end with success");
    let (_, recall) = Store::open(&folder.path().join("state")).unwrap();
    let memory = recall.memory.unwrap();
    assert!(!memory.armed && memory.restart.unwrap().steps.0 == [0; 3]);
    expect(&socket, &["status"], 3, "");
}

/// The recording is an ordinary bend log, its replay makes the same decisions, and one flipped bit is detected.
fn replays(log: &Path) {
    let read = bend_log::read(log).unwrap();
    assert!(read.ignored.is_empty() && read.t_s.len() > 1000 && read.imu.is_some());
    let replay = || {
        let out = Command::new(program()).arg("replay").arg(log).output().unwrap();
        (out.status.code(), String::from_utf8_lossy(&out.stdout).into_owned())
    };
    let (code, text) = replay();
    assert!(code == Some(0) && text.contains(" 0 differ"), "{text}");
    let tape = log.with_extension("csv.tape");
    let mut bytes = std::fs::read(&tape).unwrap();
    let at = bytes.len() - 3;
    bytes[at] ^= 0x10;
    std::fs::write(&tape, bytes).unwrap();
    assert_eq!(replay().0, Some(1));
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
    assert!(other.status.code() == Some(2) && text.contains("another retroflex"), "{text}");
    daemon.end().unwrap();
}

/// Readers take all places of the status socket and a client floods the command socket; a stop still takes effect.
#[test]
fn a_stop_takes_effect_under_load() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    daemon.take_off().unwrap();
    daemon.until(5.0, "motion", |s| s["mode"] == "tracking").unwrap();
    let mut client = daemon.client().unwrap();
    let status_socket = folder.path().join("status.sock");
    let readers: Vec<UnixStream> = (0..40).filter_map(|_| UnixStream::connect(&status_socket).ok()).collect();
    let done = Arc::new(AtomicBool::new(false));
    let bend = Request::Bend { bend_deg: 60.0, dir_deg: 30.0, length_mm: None, speed_deg_s: None };
    let flood = |mut stream: UnixStream, line: String| {
        let done = Arc::clone(&done);
        stream.set_nonblocking(true).unwrap();
        std::thread::spawn(move || {
            while !done.load(Ordering::Relaxed) {
                if stream.write(line.as_bytes()).is_err() {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
        })
    };
    let mut floods: Vec<_> = readers.into_iter().map(|s| flood(s, request_line(1, &Request::Subscribe { rate_hz: 1000.0 }))).collect();
    floods.push(flood(UnixStream::connect(daemon.socket()).unwrap(), request_line(1, &bend)));
    std::thread::sleep(Duration::from_millis(500));
    let started = Instant::now();
    client.request(&Request::Stop {}).unwrap();
    eprintln!("the stop was answered within {:.1} ms", started.elapsed().as_secs_f64() * 1e3);
    let refused = client.request(&bend).unwrap_err().message;
    assert!(refused.contains("retroflex arm"), "a bend after the stop: {refused}");
    done.store(true, Ordering::Relaxed);
    floods.into_iter().for_each(|thread| thread.join().unwrap());
    daemon.until(5.0, "the hold", |s| s["mode"] == "holding" && s["stopped"] == true).unwrap();
    daemon.kill();
}
