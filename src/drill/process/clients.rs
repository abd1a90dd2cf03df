//! Clients that misbehave, on a service that runs in real time.

use super::{Daemon, ask};
use crate::drill::Row;
use crate::service::protocol::{Request, request_line};
use serde_json::Value;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// How long a client misbehaves, s.
const FOR_S: f64 = 2.0;
/// Longest wait of a well-behaved client meanwhile, s.
const ANSWER_MAX_S: f64 = 0.5;

/// All rows on one service.
pub fn rows(program: &Path, folder: &Path) -> io::Result<Vec<Row>> {
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    let baseline = turns(&daemon, FOR_S)?;
    let mut rows = vec![
        flood(&daemon, &baseline)?,
        half_open(&daemon, &baseline)?,
        slow_reader(&daemon)?,
        huge_line(&daemon)?,
        garbage(&daemon)?,
        two_clients(&daemon)?,
    ];
    rows.push(dead_man(&daemon)?);
    let (well, took_s) = daemon.end()?;
    let mut row = Row::process("sigterm_while_bent", Some(took_s), "relaxed", format!("relaxed and ended within {took_s:.1} s"));
    row.demand(well, |_| "did not end well".to_owned());
    rows.push(row);
    Ok(rows)
}

/// How the loop fared for a while: turns made as a share of the clock, and of these late.
struct Turns {
    share: f64,
    lost: f64,
}

fn turns(daemon: &Daemon, seconds: f64) -> io::Result<Turns> {
    let mut client = daemon.client()?;
    let read = |s: &Value| (s["turns"].as_f64().unwrap_or(0.0), s["lost_frames"].as_f64().unwrap_or(0.0), Instant::now());
    let before = read(&ask(&mut client, &Request::Status {})?);
    std::thread::sleep(Duration::from_secs_f64(seconds));
    let after = read(&ask(&mut client, &Request::Status {})?);
    let clock_s = after.2.duration_since(before.2).as_secs_f64();
    Ok(Turns { share: (after.0 - before.0) * 1e-3 / clock_s, lost: after.1 - before.1 })
}

/// Slowest of some answers to a well-behaved client, s.
fn slowest(daemon: &Daemon, times: u32) -> io::Result<f64> {
    let mut client = daemon.client()?;
    let mut slowest = 0.0f64;
    for _ in 0..times {
        let begun = Instant::now();
        ask(&mut client, &Request::Status {})?;
        slowest = slowest.max(begun.elapsed().as_secs_f64());
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(slowest)
}

fn state(daemon: &Daemon) -> io::Result<String> {
    let mut client = daemon.client()?;
    Ok(ask(&mut client, &Request::Status {})?["mode"].as_str().unwrap_or_default().to_owned())
}

fn flood(daemon: &Daemon, baseline: &Turns) -> io::Result<Row> {
    let mut row = Row::process("client_flood", None, "", String::new());
    let socket = daemon.socket().to_owned();
    let flooder = std::thread::spawn(move || -> io::Result<u64> {
        let mut stream = UnixStream::connect(&socket)?;
        stream.set_nonblocking(true)?;
        let line = request_line(1, &Request::Status {});
        let begun = Instant::now();
        let mut sent = 0u64;
        while begun.elapsed().as_secs_f64() < FOR_S {
            match stream.write(line.as_bytes()) {
                Ok(n) => sent += n as u64,
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => std::thread::sleep(Duration::from_micros(200)),
                Err(_) => break,
            }
        }
        Ok(sent)
    });
    let begun = Instant::now();
    let waited = slowest(daemon, 30)?;
    let meanwhile = turns(daemon, 0.5)?;
    let sent = flooder.join().map_err(|_| io::Error::other("the flooder died"))??;
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    row.state = state(daemon)?;
    row.message = format!(
        "{} KiB of commands: made to wait or dropped; others were answered within {:.0} ms, the loop made {:.1} % of its turns ({:.1} % before)",
        sent / 1024,
        waited * 1e3,
        meanwhile.share * 100.0,
        baseline.share * 100.0
    );
    row.demand(waited < ANSWER_MAX_S, |_| format!("others waited {waited:.2} s"));
    row.demand(meanwhile.share > 0.9 * baseline.share, |_| "the loop noticed".to_owned());
    row.demand(meanwhile.lost <= baseline.lost, |_| format!("{} frames were lost", meanwhile.lost));
    Ok(row)
}

fn half_open(daemon: &Daemon, baseline: &Turns) -> io::Result<Row> {
    let mut row = Row::process("client_half_open", None, "", String::new());
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.write_all(b"{\"v\":1,\"cmd\":\"be")?;
    stream.set_read_timeout(Some(Duration::from_secs(8)))?;
    let begun = Instant::now();
    let waited = slowest(daemon, 10)?;
    let mut rest = Vec::new();
    // it says nothing more; being dropped reads as the end
    let dropped = stream.read_to_end(&mut rest).is_ok();
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    row.state = state(daemon)?;
    row.message = format!("dropped after {:.1} s; others were answered within {:.0} ms", begun.elapsed().as_secs_f64(), waited * 1e3);
    row.demand(dropped, |_| "was not dropped".to_owned());
    row.demand(waited < ANSWER_MAX_S && baseline.share > 0.0, |_| format!("others waited {waited:.2} s"));
    Ok(row)
}

fn slow_reader(daemon: &Daemon) -> io::Result<Row> {
    let mut row = Row::process("client_slow_reader", None, "", String::new());
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.write_all(request_line(1, &Request::Subscribe { rate_hz: 1000.0 }).as_bytes())?;
    let begun = Instant::now();
    let mut client = daemon.client()?;
    let alone = |c: &mut crate::service::client::Client| -> io::Result<bool> { Ok(ask(c, &Request::Status {})?["clients"] == 1) };
    while begun.elapsed().as_secs_f64() < 8.0 && !alone(&mut client)? {
        std::thread::sleep(Duration::from_millis(20));
    }
    let dropped = alone(&mut client)?;
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    row.state = state(daemon)?;
    row.message = format!("asked for 1000 frames a second, read none, dropped after {:.1} s", begun.elapsed().as_secs_f64());
    row.demand(dropped, |_| "was not dropped".to_owned());
    Ok(row)
}

fn huge_line(daemon: &Daemon) -> io::Result<Row> {
    let mut row = Row::process("client_10_mb_line", None, "", String::new());
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    stream.set_write_timeout(Some(Duration::from_secs(5)))?;
    let begun = Instant::now();
    let block = vec![b'x'; 64 * 1024];
    let mut sent = 0;
    while sent < 10 * 1024 * 1024 && stream.write_all(&block).is_ok() {
        sent += block.len();
    }
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    let mut said = [0u8; 512];
    let n = stream.read(&mut said).unwrap_or(0);
    let said = String::from_utf8_lossy(&said[..n]).into_owned();
    row.state = state(daemon)?;
    row.message = format!("dropped after {} KiB: {}", sent / 1024, said.trim());
    row.demand(sent < 10 * 1024 * 1024, |_| "took all of it".to_owned());
    Ok(row)
}

fn garbage(daemon: &Daemon) -> io::Result<Row> {
    let mut row = Row::process("client_garbage", None, "", String::new());
    let mut stream = UnixStream::connect(daemon.socket())?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    let begun = Instant::now();
    stream.write_all(b"{]\n\xff\xfe\n")?;
    let mut said = String::new();
    // the second line is no text: it is answered and the connection ends
    let _ = stream.read_to_string(&mut said);
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    row.state = state(daemon)?;
    row.demand(said.contains("not JSON") && said.contains("UTF-8"), |_| format!("said `{}`", said.trim()));
    row.message = said.lines().next().unwrap_or_default().to_owned();
    Ok(row)
}

fn two_clients(daemon: &Daemon) -> io::Result<Row> {
    let mut row = Row::process("two_clients", None, "", String::new());
    let begun = Instant::now();
    let commanding = |bend_deg: f64| {
        let client = daemon.client();
        std::thread::spawn(move || -> io::Result<u32> {
            let mut client = client?;
            let mut taken = 0;
            for _ in 0..50 {
                ask(&mut client, &Request::Bend { bend_deg, dir_deg: 30.0, length_mm: None, speed_deg_s: None })?;
                taken += 1;
            }
            Ok(taken)
        })
    };
    let (one, two) = (commanding(30.0), commanding(50.0));
    let lost = || io::Error::other("a client died");
    let taken = one.join().map_err(|_| lost())?? + two.join().map_err(|_| lost())??;
    let status = daemon.until(6.0, "rest", |s| s["settled"] == true)?;
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    row.state = status["mode"].as_str().unwrap_or_default().to_owned();
    let (target, estimate) = (status["target"]["bend_deg"].as_f64().unwrap_or(0.0), status["felt"]["bend_deg"].as_f64().unwrap_or(0.0));
    row.message = format!("{taken} commands from two clients, all answered; the last one holds: {target:.0}°");
    row.error_deg_after = (target - estimate).abs();
    row.demand(taken == 100, |_| format!("{taken} of 100 were taken"));
    row.demand([30.0, 50.0].iter().any(|b| (target - b).abs() < 0.1), |_| format!("the target is {target}°"));
    row.demand(row.error_deg_after < 1.5, |row| format!("{:.1}° off", row.error_deg_after));
    Ok(row)
}

/// A stream of set-points that falls silent.
fn dead_man(daemon: &Daemon) -> io::Result<Row> {
    let mut row = Row::process("stream_silent", None, "", String::new());
    let mut client = daemon.client()?;
    for k in 0..20 {
        ask(&mut client, &Request::Stream { bend_deg: 30.0 + f64::from(k), dir_deg: 30.0, length_mm: None })?;
        std::thread::sleep(Duration::from_millis(20));
    }
    ask(&mut client, &Request::Stream { bend_deg: 75.0, dir_deg: 30.0, length_mm: None })?;
    let begun = Instant::now();
    let status = daemon.until(3.0, "the stop", |s| s["mode"] == "holding")?;
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    row.state = "holding".to_owned();
    row.message = "the stream of set-points fell silent: stopped".to_owned();
    row.demand(row.detected_s.is_some_and(|s| s < 1.0), |row| format!("stopped after {:?} s", row.detected_s));
    row.demand(status["felt"]["bend_deg"].as_f64().is_some_and(|b| b < 74.0), |_| "ran on to the last set-point".to_owned());
    Ok(row)
}
