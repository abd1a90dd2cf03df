//! `stop` under attack: it is answered, the tip brakes, and nothing moves until the next `arm`.

use super::attack::Attack;
use super::daemon::{Daemon, WATCHDOG_S, ask};
use crate::drill::bench::BenchConfig;
use crate::drill::row::Row;
use crate::drill::run::Allowance;
use crate::service::client::Client;
use crate::service::protocol::Request;
use serde_json::Value;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// Longest time until `stop` is answered, s.
const ANSWER_MAX_S: f64 = 0.2;
/// Time from the answer to the end of the braking, and as long again in which nothing may move.
const SETTLES: Duration = Duration::from_millis(150);
/// Longest time until an attacked service accepts an `arm`, s.
const ARM_MAX_S: f64 = 20.0;

fn bend() -> Request {
    Request::Bend { bend_deg: 30.0, dir_deg: 200.0, length_mm: None, speed_deg_s: None }
}

/// Every attack, and whether it lets the tip move again after a stop.
fn attacks() -> Vec<(&'static str, Attack, bool)> {
    vec![
        ("stop_among_silent_clients", Attack::Silent, true),
        ("stop_among_connects", Attack::Connects, true),
        ("stop_among_hoarders", Attack::Hoards, true),
        ("stop_in_a_flood_of_bend", Attack::Floods(bend, 3), true),
        ("stop_in_a_flood_of_hold", Attack::Floods(|| Request::Hold {}, 31), false),
        ("stop_in_a_flood_of_status", Attack::Floods(|| Request::Status {}, 8), true),
        ("stop_in_garbage", Attack::Garbage, true),
        ("stop_among_readers", Attack::Readers, true),
        ("stop_among_deaf_readers", Attack::Deaf, true),
        ("stop_with_a_hung_disk", Attack::Hang("state"), true),
        ("stop_with_a_hung_status_thread", Attack::Hang("status"), true),
        ("stop_with_a_hung_hub", Attack::Hang("hub"), false),
    ]
}

/// One row for each attack, with this many stops.
///
/// # Errors
/// A service that does not start.
pub fn rows(config: &BenchConfig, program: &Path, folder: &Path, tries: u32, selected: &dyn Fn(&str) -> bool) -> io::Result<Vec<Row>> {
    let steps_allowed = Allowance::new(config).map_err(io::Error::other)?.stopping();
    let requires = format!(
        "{tries} of {tries} stops are answered within {ANSWER_MAX_S} s; at most {steps_allowed} microsteps follow the answer; the watchdog is fed"
    );
    let run = |name: &str, requires: &str, test: &dyn Fn(Daemon, &mut Row) -> io::Result<()>| {
        let mut row = Row { steps_allowed, ..Row::new(name, requires) };
        if let Err(e) = Daemon::start(program, &folder.join(name)).and_then(|daemon| test(daemon, &mut row)) {
            row.fail(format!("{e}"));
        }
        row
    };
    let attacked =
        |(name, attack, moves): (&str, Attack, bool)| run(name, &requires, &|daemon, row| one(&daemon, attack, tries, moves, row));
    let mut rows: Vec<Row> = attacks().into_iter().filter(|(name, ..)| selected(name)).map(attacked).collect();
    let single: [(&str, &str, &dyn Fn(Daemon, &mut Row) -> io::Result<()>); 2] = [
        ("hung_command_thread", "the tip stops within 2 s and the stop is latched", &hung_control),
        ("client_dies_in_motion", "the tip holds within 0.5 s, before the target, and the client's recording ends", &abandoned),
    ];
    rows.extend(single.into_iter().filter(|(name, ..)| selected(name)).map(|(name, requires, test)| run(name, requires, test)));
    Ok(rows)
}

fn one(daemon: &Daemon, attack: Attack, tries: u32, moves: bool, row: &mut Row) -> io::Result<()> {
    daemon.take_off()?;
    daemon.until(5.0, "motion", |s| s["mode"] == "tracking")?;
    while daemon.notification().is_some() {}
    let began = Instant::now();
    let attackers = attack.start(daemon)?;
    std::thread::sleep(Duration::from_millis(200));
    let (mut slowest_s, mut answered) = (0.0f64, 0);
    for n in 0..tries {
        if n > 0 && moves {
            move_again(daemon, n)?;
        }
        let started = Instant::now();
        let reply = daemon.client().and_then(|mut client| ask(&mut client, &Request::Stop {}));
        let took_s = started.elapsed().as_secs_f64();
        slowest_s = slowest_s.max(took_s);
        answered += u32::from(reply.is_ok());
        row.require(reply.is_ok(), |_| format!("stop {n}: {reply:?}"));
        if moves {
            row.steps_after = row.steps_after.max(travelled(daemon)?);
        }
    }
    let (fed, expected) = (heartbeats(daemon), began.elapsed().as_secs_f64() / WATCHDOG_S);
    drop(attackers);
    let status = daemon.until(10.0, "the latch", |s| s["stopped"] == true)?;
    row.state = status["mode"].as_str().unwrap_or_default().to_owned();
    row.detected_s = Some(slowest_s);
    row.message = format!(
        "{answered} of {tries} answered, the slowest within {:.1} ms; {fed} heartbeats; {} late cycles of {}",
        slowest_s * 1e3,
        status["late_cycles"],
        status["cycles"]
    );
    row.require(slowest_s <= ANSWER_MAX_S, |_| format!("a stop was answered after {slowest_s:.3} s"));
    row.require(row.steps_after <= row.steps_allowed, |row| format!("{} microsteps after the answer", row.steps_after));
    row.require(f64::from(fed) >= expected.floor(), |_| format!("{fed} heartbeats in {expected:.0} time-outs of the watchdog"));
    Ok(())
}

/// Arms and bends, however often the attackers get in the way.
fn move_again(daemon: &Daemon, n: u32) -> io::Result<()> {
    let target =
        Request::Bend { bend_deg: 60.0, dir_deg: if n.is_multiple_of(2) { 30.0 } else { 210.0 }, length_mm: None, speed_deg_s: None };
    let started = Instant::now();
    // a loop that was late for the attackers' sake has tripped; without a fault the reset is refused
    let order = |request: &Request| daemon.client().and_then(|mut client| ask(&mut client, request));
    loop {
        let _ = order(&Request::ResetFault {});
        match order(&Request::Arm {}).and_then(|_| order(&target)) {
            Ok(_) => break,
            Err(e) if started.elapsed().as_secs_f64() > ARM_MAX_S => return Err(e),
            Err(_) => std::thread::sleep(Duration::from_millis(10)),
        }
    }
    std::thread::sleep(Duration::from_millis(80));
    Ok(())
}

/// Microsteps of all channels after a stop, until twice the time that braking takes.
fn travelled(daemon: &Daemon) -> io::Result<i64> {
    let counted = || -> io::Result<[i64; 3]> {
        let status = answer(daemon, &Request::Status {})?;
        Ok(std::array::from_fn(|i| status["counted"][i].as_i64().unwrap_or(i64::MAX / 4)))
    };
    let before = counted()?;
    let mut most = 0;
    for _ in 0..2 {
        std::thread::sleep(SETTLES);
        let after = counted()?;
        most = most.max((0..3).map(|i| (after[i] - before[i]).abs()).sum());
    }
    Ok(most)
}

/// Asks until there is an answer: attackers may take the place of a client that waits.
fn answer(daemon: &Daemon, request: &Request) -> io::Result<Value> {
    let started = Instant::now();
    loop {
        match daemon.client().and_then(|mut client: Client| ask(&mut client, request)) {
            Err(_) if started.elapsed().as_secs_f64() < ARM_MAX_S => {}
            result => return result,
        }
    }
}

fn heartbeats(daemon: &Daemon) -> u32 {
    std::iter::from_fn(|| daemon.notification()).filter(|text| text.contains("WATCHDOG=1")).count() as u32
}

/// Nobody could command a stop: the loop stops the tip by itself.
#[allow(clippy::needless_pass_by_value, reason = "the service ends with the row")]
fn hung_control(daemon: Daemon, row: &mut Row) -> io::Result<()> {
    daemon.take_off()?;
    let started = Instant::now();
    let _attackers = Attack::Hang("control").start(&daemon)?;
    let mut reader = Client::connect(&daemon.socket().with_file_name("status.sock")).map_err(|f| io::Error::other(f.message))?;
    while started.elapsed() < Duration::from_secs(5) {
        let status = ask(&mut reader, &Request::Status {})?;
        row.state = status["mode"].as_str().unwrap_or_default().to_owned();
        if status["stopped"] == true {
            row.detected_s = Some(started.elapsed().as_secs_f64());
            row.message = format!("the command thread was silent for {} s", status["thread_age_s"]["control"]);
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    row.require(row.detected_s.is_some_and(|s| s <= 2.0), |row| format!("stopped after {:?} s", row.detected_s));
    Ok(())
}

/// A client that attends its motion and dies: the tip holds, and its recording ends.
#[allow(clippy::needless_pass_by_value, reason = "the service ends with the row")]
fn abandoned(daemon: Daemon, row: &mut Row) -> io::Result<()> {
    daemon.until(15.0, "alignment", |s| s["mode"] == "disarmed")?;
    let mut client = daemon.client()?;
    let record = Request::Record { action: crate::service::protocol::RecordAction::Start, name: Some("x".to_owned()), owned: true };
    ask(&mut client, &record)?;
    // the recording begins with an alignment
    daemon.until(15.0, "alignment", |s| s["mode"] == "disarmed" && s["recording"]["rows"].as_u64().is_some_and(|n| n > 0))?;
    ask(&mut client, &Request::Arm {})?;
    daemon.until(5.0, "energised drivers", |s| s["energised"] == true)?;
    ask(&mut client, &Request::Bend { bend_deg: 70.0, dir_deg: 30.0, length_mm: None, speed_deg_s: Some(20.0) })?;
    std::thread::sleep(Duration::from_millis(1000));
    let started = Instant::now();
    drop(client);
    let status = daemon.until(5.0, "the hold", |s| s["mode"] == "holding")?;
    row.detected_s = Some(started.elapsed().as_secs_f64());
    let ended = daemon.until(5.0, "the end of the recording", |s| s["recording"].is_null())?;
    row.state = "holding".to_owned();
    row.message = ended["recording_ended"].as_str().unwrap_or_default().to_owned();
    row.require(row.detected_s.is_some_and(|s| s <= 0.5), |row| format!("held after {:?} s", row.detected_s));
    row.require(status["estimate"]["bend_deg"].as_f64().is_some_and(|b| b < 60.0), |_| format!("moved on: {}", status["estimate"]));
    Ok(())
}
