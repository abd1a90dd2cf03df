//! Clients that contradict each other, fall silent or die, of a service that runs in real time.

use super::daemon::{Daemon, ask, insist};
use crate::drill::row::Row;
use crate::service::protocol::{Frame, RecordAction, Request};
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// Names of the rows.
pub const NAMES: [&str; 4] = ["two_clients", "stream_silent", "client_dies_in_motion", "sigterm_while_bent"];

/// Longest time until a tip that brakes accepts another motion, s.
const BRAKED_MAX_S: f64 = 1.0;

/// All rows, on one service.
pub fn rows(program: &Path, folder: &Path) -> io::Result<Vec<Row>> {
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    let mut rows = vec![two_clients(&daemon)?, dead_man(&daemon)?, abandoned(&daemon)?];
    let (success, took_s) = daemon.end()?;
    let mut row = Row {
        detected_s: Some(took_s),
        state: "relaxed".to_owned(),
        message: format!("relaxed and ended within {took_s:.1} s"),
        ..Row::new(NAMES[3], "the tip returns to rest, then the service ends with success")
    };
    row.require(success, |_| "the service did not end with success".to_owned());
    rows.push(row);
    Ok(rows)
}

/// A row that is detected now, with the mode of the service.
fn row(daemon: &Daemon, name: &str, requires: &str, started: Instant, message: String) -> io::Result<Row> {
    let detected_s = Some(started.elapsed().as_secs_f64());
    let status = ask(&mut daemon.client()?, &Request::Status {})?;
    Ok(Row { detected_s, state: status["mode"].as_str().unwrap_or_default().to_owned(), message, ..Row::new(name, requires) })
}

fn two_clients(daemon: &Daemon) -> io::Result<Row> {
    let started = Instant::now();
    let commanding = |bend_deg: f64| {
        let client = daemon.client();
        std::thread::spawn(move || -> io::Result<u32> {
            let mut client = client?;
            for _ in 0..50 {
                ask(&mut client, &Request::Bend { bend_deg, dir_deg: 30.0, length_mm: None, speed_deg_s: None, frame: Frame::Base })?;
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
    let mut row = row(daemon, NAMES[0], "all commands are accepted, and the tip settles within 1.5° of one target", started, message)?;
    row.error_deg_after = (target - estimate).abs();
    row.require([30.0, 50.0].iter().any(|b| (target - b).abs() < 0.1), |_| format!("the target is {target}°"));
    row.require(row.error_deg_after < 1.5, |row| format!("error {:.1}°", row.error_deg_after));
    Ok(row)
}

/// A stream of set-points that falls silent.
fn dead_man(daemon: &Daemon) -> io::Result<Row> {
    let mut client = daemon.client()?;
    let mut stream = |bend_deg| ask(&mut client, &Request::Stream { bend_deg, dir_deg: 30.0, length_mm: None, t_s: None });
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

/// A client that attends its motion and dies: the tip holds, and its recording ends.
fn abandoned(daemon: &Daemon) -> io::Result<Row> {
    let mut client = daemon.client()?;
    ask(&mut client, &Request::Record { action: RecordAction::Start, name: Some("x".to_owned()), owned: true })?;
    let away = Request::Bend { bend_deg: 10.0, dir_deg: 210.0, length_mm: None, speed_deg_s: Some(20.0), frame: Frame::Base };
    insist(BRAKED_MAX_S, || ask(&mut client, &away))?;
    std::thread::sleep(Duration::from_millis(1000));
    let started = Instant::now();
    drop(client);
    let status = daemon.until(5.0, "the hold", |s| s["mode"] == "holding")?;
    let requires = "the tip holds within 0.5 s, before the target, and the client's recording ends";
    let mut row = row(daemon, NAMES[2], requires, started, String::new())?;
    let ended = daemon.until(5.0, "the end of the recording", |s| s["recording"].is_null())?;
    row.message = ended["recording_ended"].as_str().unwrap_or_default().to_owned();
    row.require(row.detected_s.is_some_and(|s| s <= 0.5), |row| format!("held after {:?} s", row.detected_s));
    row.require(status["estimate"]["bend_deg"].as_f64().is_some_and(|b| b > 20.0), |_| format!("moved on: {}", status["estimate"]));
    Ok(row)
}
