//! Clients that contradict each other, fall silent or die, of a service that runs in real time.

use super::daemon::{Daemon, ask, insist, mode_of};
use crate::drill::row::{FaultResult, require};
use crate::service::{RecordAction, Request};
use serde_json::Value;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// Names of the rows.
pub const NAMES: [&str; 4] = [
    "two_clients",
    "stream_silent",
    "client_dies_in_motion",
    "sigterm_while_bent",
];

/// Longest time until a tip that brakes accepts another motion, s.
const BRAKED_MAX_S: f64 = 1.0;

/// All rows, on one service.
pub fn rows(program: &Path, folder: &Path) -> io::Result<Vec<FaultResult>> {
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    let mut rows = vec![two_clients(&daemon)?, dead_man(&daemon)?];
    rows.push(abandoned(&daemon)?);
    let (success, took_s) = daemon.end()?;
    let requires = "the tip returns to rest, then the service ends with success";
    let mut row = FaultResult::new(NAMES[3], requires).ending("relaxed");
    row.detected_s = Some(took_s);
    row.message = format!("relaxed and ended within {took_s:.1} s");
    require!(row: success; "the service did not end with success");
    rows.push(row);
    Ok(rows)
}

/// A row that is detected now, with the mode of the service.
fn row(daemon: &Daemon, name: &str, requires: &str, started: Instant) -> io::Result<FaultResult> {
    let detected_s = Some(started.elapsed().as_secs_f64());
    let status = daemon.ask(&Request::Status {})?;
    let row = FaultResult::new(name, requires).ending(&mode_of(&status));
    Ok(FaultResult { detected_s, ..row })
}

fn two_clients(daemon: &Daemon) -> io::Result<FaultResult> {
    let started = Instant::now();
    let commanding = |bend_deg: f64| {
        let client = daemon.client();
        std::thread::spawn(move || -> io::Result<u32> {
            let mut client = client?;
            for _ in 0..50 {
                ask(&mut client, &Request::bend(bend_deg, 30.0, None, None))?;
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
    let requires = "all commands are accepted, and the tip settles within 1.5° of one target";
    let mut row = row(daemon, NAMES[0], requires, started)?;
    row.message = format!(
        "{accepted} commands of two clients were accepted; the last one is in effect: {target:.0}°"
    );
    row.error_deg_after = (target - estimate).abs();
    let meant = [30.0, 50.0].iter().any(|b| (target - b).abs() < 0.1);
    require!(row: meant; "the target is {target}°");
    require!(row: row.error_deg_after < 1.5; "error {:.1}°", row.error_deg_after);
    Ok(row)
}

/// A stream of set-points that falls silent.
fn dead_man(daemon: &Daemon) -> io::Result<FaultResult> {
    let mut client = daemon.client()?;
    let mut stream = |bend_deg| ask(&mut client, &Request::stream(bend_deg, 30.0, None));
    for k in 0..20 {
        stream(30.0 + f64::from(k))?;
        std::thread::sleep(Duration::from_millis(20));
    }
    stream(75.0)?;
    let started = Instant::now();
    let status = daemon.until(3.0, "the stop", |s| s["mode"] == "holding")?;
    let requires = "the tip stops within 1 s, before the last set-point";
    let mut row = row(daemon, NAMES[1], requires, started)?;
    row.message = "the stream of set-points paused for too long: stopped".to_owned();
    let (after_s, bend_deg) = (row.detected_s, status["estimate"]["bend_deg"].as_f64());
    require!(row: after_s.is_some_and(|s| s < 1.0); "stopped after {after_s:?} s");
    require!(row: bend_deg.is_some_and(|b| b < 74.0); "moved to the last set-point");
    Ok(row)
}

/// A client that attends its motion and dies: the tip holds, and its recording ends.
fn abandoned(daemon: &Daemon) -> io::Result<FaultResult> {
    let mut client = daemon.client()?;
    let record = Request::Record {
        action: RecordAction::Start,
        name: Some("x".to_owned()),
        owned: true,
    };
    ask(&mut client, &record)?;
    let away = Request::bend(10.0, 210.0, None, Some(20.0));
    insist(BRAKED_MAX_S, || ask(&mut client, &away))?;
    std::thread::sleep(Duration::from_millis(1000));
    let started = Instant::now();
    drop(client);
    let status = daemon.until(5.0, "the hold", |s| s["mode"] == "holding")?;
    let requires = "the tip holds within 0.5 s, before the target, and the client's recording ends";
    let mut row = row(daemon, NAMES[2], requires, started)?;
    let over = |s: &Value| s["recording"].is_null();
    let ended = daemon.until(5.0, "the end of the recording", over)?;
    let why = ended["recording_ended"].as_str();
    row.message = why.unwrap_or_default().to_owned();
    let (after_s, estimate) = (row.detected_s, &status["estimate"]);
    let bend_deg = estimate["bend_deg"].as_f64();
    require!(row: after_s.is_some_and(|s| s <= 0.5); "held after {after_s:?} s");
    require!(row: bend_deg.is_some_and(|b| b > 20.0); "moved on: {estimate}");
    Ok(row)
}
