//! Misbehaving clients of a service that runs in real time.

use super::daemon::{Daemon, ask};
use crate::drill::row::Row;
use crate::service::protocol::{Request, request_line};
use serde_json::Value;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// Duration of a misbehaviour, s.
const DURATION_S: f64 = 2.0;
/// Longest wait of a well-behaved client meanwhile, s.
const REPLY_MAX_S: f64 = 0.5;

/// Names of the rows.
pub const NAMES: [&str; 8] = [
    "client_flood",
    "client_half_open",
    "client_slow_reader",
    "client_10_mb_line",
    "client_garbage",
    "two_clients",
    "stream_silent",
    "sigterm_while_bent",
];

/// All rows, on one service.
pub fn rows(program: &Path, folder: &Path) -> io::Result<Vec<Row>> {
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    let baseline = cycles(&daemon, DURATION_S)?;
    let mut rows = vec![
        flood(&daemon, &baseline)?,
        half_open(&daemon)?,
        slow_reader(&daemon)?,
        huge_line(&daemon)?,
        garbage(&daemon)?,
        two_clients(&daemon)?,
        dead_man(&daemon)?,
    ];
    let (success, took_s) = daemon.end()?;
    let mut row = Row {
        detected_s: Some(took_s),
        state: "relaxed".to_owned(),
        message: format!("relaxed and ended within {took_s:.1} s"),
        ..Row::new("sigterm_while_bent", "the tip returns to rest, then the service ends with success")
    };
    row.require(success, |_| "the service did not end with success".to_owned());
    rows.push(row);
    Ok(rows)
}

/// Cycles of the loop as a share of real time, and frames lost.
struct Cycles {
    share: f64,
    lost: f64,
}

fn cycles(daemon: &Daemon, seconds: f64) -> io::Result<Cycles> {
    let mut client = daemon.client()?;
    let read = |s: &Value| (s["cycles"].as_f64().unwrap_or(0.0), s["lost_frames"].as_f64().unwrap_or(0.0), Instant::now());
    let before = read(&ask(&mut client, &Request::Status {})?);
    std::thread::sleep(Duration::from_secs_f64(seconds));
    let after = read(&ask(&mut client, &Request::Status {})?);
    let clock_s = after.2.duration_since(before.2).as_secs_f64();
    // the built-in plant runs at 1 kHz
    Ok(Cycles { share: (after.0 - before.0) * 1e-3 / clock_s, lost: after.1 - before.1 })
}

/// Slowest of some replies to a well-behaved client, s.
fn slowest_reply(daemon: &Daemon, times: u32) -> io::Result<f64> {
    let mut client = daemon.client()?;
    let mut slowest = 0.0f64;
    for _ in 0..times {
        let started = Instant::now();
        ask(&mut client, &Request::Status {})?;
        slowest = slowest.max(started.elapsed().as_secs_f64());
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(slowest)
}

/// A row that is detected now, with the mode of the service.
fn row(daemon: &Daemon, name: &str, requires: &str, started: Instant, message: String) -> io::Result<Row> {
    let detected_s = Some(started.elapsed().as_secs_f64());
    let status = ask(&mut daemon.client()?, &Request::Status {})?;
    Ok(Row { detected_s, state: status["mode"].as_str().unwrap_or_default().to_owned(), message, ..Row::new(name, requires) })
}

fn flood(daemon: &Daemon, baseline: &Cycles) -> io::Result<Row> {
    let socket = daemon.socket().to_owned();
    let flooder = std::thread::spawn(move || -> io::Result<u64> {
        let mut stream = UnixStream::connect(&socket)?;
        stream.set_nonblocking(true)?;
        let line = request_line(1, &Request::Status {});
        let started = Instant::now();
        let mut sent = 0u64;
        while started.elapsed().as_secs_f64() < DURATION_S {
            match stream.write(line.as_bytes()) {
                Ok(n) => sent += n as u64,
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => std::thread::sleep(Duration::from_micros(200)),
                Err(_) => break,
            }
        }
        Ok(sent)
    });
    let started = Instant::now();
    let waited_s = slowest_reply(daemon, 30)?;
    let meanwhile = cycles(daemon, 0.5)?;
    let sent = flooder.join().map_err(|_| io::Error::other("the flooding client panicked"))??;
    let message = format!(
        "{} KiB of commands were slowed down or refused; others were answered within {:.0} ms; the loop ran {:.1} % of its cycles ({:.1} % before)",
        sent / 1024,
        waited_s * 1e3,
        meanwhile.share * 100.0,
        baseline.share * 100.0
    );
    let mut row = row(
        daemon,
        "client_flood",
        "others are answered within 0.5 s; the loop runs 0.9 of its cycles; no frame is lost",
        started,
        message,
    )?;
    row.require(waited_s < REPLY_MAX_S, |_| format!("others waited {waited_s:.2} s"));
    row.require(meanwhile.share > 0.9 * baseline.share, |_| "the loop lost cycles".to_owned());
    row.require(meanwhile.lost <= baseline.lost, |_| format!("{} frames were lost", meanwhile.lost));
    Ok(row)
}

fn half_open(daemon: &Daemon) -> io::Result<Row> {
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.write_all(b"{\"v\":1,\"cmd\":\"be")?;
    stream.set_read_timeout(Some(Duration::from_secs(8)))?;
    let started = Instant::now();
    let waited_s = slowest_reply(daemon, 10)?;
    // a disconnection reads as the end of the stream
    let dropped = stream.read_to_end(&mut Vec::new()).is_ok();
    let message =
        format!("disconnected after {:.1} s; others were answered within {:.0} ms", started.elapsed().as_secs_f64(), waited_s * 1e3);
    let mut row =
        row(daemon, "client_half_open", "the client is disconnected within 8 s; others are answered within 0.5 s", started, message)?;
    row.require(dropped, |_| "not disconnected".to_owned());
    row.require(waited_s < REPLY_MAX_S, |_| format!("others waited {waited_s:.2} s"));
    Ok(row)
}

fn slow_reader(daemon: &Daemon) -> io::Result<Row> {
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.write_all(request_line(1, &Request::Subscribe { rate_hz: 1000.0 }).as_bytes())?;
    let started = Instant::now();
    // only the polling client itself is left
    let dropped = daemon.until(8.0, "the disconnection", |s| s["clients"] == 1).is_ok();
    let message =
        format!("subscribed to 1000 frames per second, read none, and was disconnected after {:.1} s", started.elapsed().as_secs_f64());
    let mut row = row(daemon, "client_slow_reader", "the client is disconnected within 8 s", started, message)?;
    row.require(dropped, |_| "not disconnected".to_owned());
    Ok(row)
}

fn huge_line(daemon: &Daemon) -> io::Result<Row> {
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    stream.set_write_timeout(Some(Duration::from_secs(5)))?;
    let started = Instant::now();
    let block = vec![b'x'; 64 * 1024];
    let mut sent = 0;
    while sent < 10 * 1024 * 1024 && stream.write_all(&block).is_ok() {
        sent += block.len();
    }
    let mut reply = [0u8; 512];
    let n = stream.read(&mut reply).unwrap_or(0);
    let message = format!("disconnected after {} KiB: {}", sent / 1024, String::from_utf8_lossy(&reply[..n]).trim());
    let mut row = row(daemon, "client_10_mb_line", "the client is disconnected before it has sent the line", started, message)?;
    row.require(sent < 10 * 1024 * 1024, |_| "the whole line was accepted".to_owned());
    Ok(row)
}

fn garbage(daemon: &Daemon) -> io::Result<Row> {
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    let started = Instant::now();
    stream.write_all(b"{]\n\xff\xfe\n")?;
    let mut replies = String::new();
    // the service closes the connection after a line that is not UTF-8
    let _ = stream.read_to_string(&mut replies);
    let mut row = row(
        daemon,
        "client_garbage",
        "the reply says what is wrong with each line",
        started,
        replies.lines().next().unwrap_or_default().to_owned(),
    )?;
    row.require(replies.contains("not JSON") && replies.contains("UTF-8"), |_| format!("replied `{}`", replies.trim()));
    Ok(row)
}

fn two_clients(daemon: &Daemon) -> io::Result<Row> {
    let started = Instant::now();
    let commanding = |bend_deg: f64| {
        let client = daemon.client();
        std::thread::spawn(move || -> io::Result<u32> {
            let mut client = client?;
            for _ in 0..50 {
                ask(&mut client, &Request::Bend { bend_deg, dir_deg: 30.0, length_mm: None, speed_deg_s: None })?;
            }
            Ok(50)
        })
    };
    let (one, two) = (commanding(30.0), commanding(50.0));
    let panicked = |_| io::Error::other("a client panicked");
    let accepted = one.join().map_err(panicked)?? + two.join().map_err(panicked)??;
    let status = daemon.until(6.0, "the settled tip", |s| s["settled"] == true)?;
    let bend_deg = |key: &str| status[key]["bend_deg"].as_f64().unwrap_or(0.0);
    let (target, estimate) = (bend_deg("target"), bend_deg("estimate"));
    let message = format!("{accepted} commands of two clients were accepted; the last one is in effect: {target:.0}°");
    let mut row = row(daemon, "two_clients", "all commands are accepted, and the tip settles within 1.5° of one target", started, message)?;
    row.error_deg_after = (target - estimate).abs();
    row.require([30.0, 50.0].iter().any(|b| (target - b).abs() < 0.1), |_| format!("the target is {target}°"));
    row.require(row.error_deg_after < 1.5, |row| format!("error {:.1}°", row.error_deg_after));
    Ok(row)
}

/// A stream of set-points that falls silent.
fn dead_man(daemon: &Daemon) -> io::Result<Row> {
    let mut client = daemon.client()?;
    let mut stream = |bend_deg| ask(&mut client, &Request::Stream { bend_deg, dir_deg: 30.0, length_mm: None });
    for k in 0..20 {
        stream(30.0 + f64::from(k))?;
        std::thread::sleep(Duration::from_millis(20));
    }
    stream(75.0)?;
    let started = Instant::now();
    let status = daemon.until(3.0, "the stop", |s| s["mode"] == "holding")?;
    let mut row = row(
        daemon,
        "stream_silent",
        "the tip stops within 1 s, before the last set-point",
        started,
        "the stream of set-points paused for too long: stopped".to_owned(),
    )?;
    row.require(row.detected_s.is_some_and(|s| s < 1.0), |row| format!("stopped after {:?} s", row.detected_s));
    row.require(status["estimate"]["bend_deg"].as_f64().is_some_and(|b| b < 74.0), |_| "moved to the last set-point".to_owned());
    Ok(row)
}
