//! `stop` under attack: it is answered, the tip brakes, and nothing moves until the next `arm`.

use super::attack::Attack::{self, Connect, Flood, Hang, Keep};
use super::attack::Attackers;
use super::daemon::{Daemon, WATCHDOG_S, ask, connect, insist, mode_of};
use super::plan::Plan;
use crate::drill::row::{FaultResult, require};
use crate::drill::run::Allowance;
use crate::service::Request;
use std::io;
use std::time::{Duration, Instant};

/// Longest time until `stop` is answered on the command socket, and to the command line, s.
const ANSWER_MAX_S: [f64; 2] = [0.2, 0.5];
/// Time from the answer to the end of the braking, and as long again in which nothing may move.
const SETTLES: Duration = Duration::from_millis(150);
/// Longest time until an attacked service accepts an `arm`, s.
const ARM_MAX_S: f64 = 20.0;

/// Every attack, and whether it lets the tip move again after a stop.
const ATTACKS: [(&str, Attack, bool); 16] = [
    ("stop_among_silent_clients", Keep(""), true),
    ("client_half_open", Keep("{\"v\":1,\"cmd\":\"be"), true),
    ("client_slow_reader", Keep(SUBSCRIBE), true),
    ("stop_among_connects", Connect(0), true),
    ("stop_among_hoarders", Connect(200), true),
    ("stop_in_a_flood_of_bend", Flood(BEND, 6), true),
    ("stop_in_a_flood_of_hold", Flood(HOLD, 62), false),
    ("stop_in_a_flood_of_stop", Attack::Stop, false),
    ("client_flood", Flood(STATUS, 8), true),
    ("client_garbage", Flood("{]\n", 8), true),
    ("client_10_mb_line", Flood(LINE, 8), true),
    ("stop_among_readers", Flood(SUBSCRIBE, 16), true),
    ("stop_with_a_hung_disk", Hang("state"), true),
    ("stop_with_a_hung_status_thread", Hang("status"), true),
    ("stop_with_a_hung_stop_thread", Hang("stop"), true),
    ("stop_with_a_hung_hub", Hang("hub"), false),
];
const BEND: &str = "{\"v\":1,\"cmd\":\"bend\",\"bend_deg\":30,\"dir_deg\":200}\n";
/// Part of a line without an end.
const LINE: &str = "xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx";
const HOLD: &str = "{\"v\":1,\"cmd\":\"hold\"}\n";
const STATUS: &str = "{\"v\":1,\"cmd\":\"status\"}\n";
const SUBSCRIBE: &str = "{\"v\":1,\"cmd\":\"subscribe\",\"rate_hz\":1000}\n";
/// Nobody who connects to the command socket is answered: the loop stops the tip by itself.
const HUNG_COMMANDS: &str = "hung_command_thread";

/// One row for each attack, with this many stops.
///
/// # Errors
/// A service that does not start.
pub fn rows(plan: &Plan<'_>) -> io::Result<Vec<FaultResult>> {
    let (tries, selected) = (plan.tries, plan.selected);
    let folder = plan.scratch.join("attacks");
    let allowance = Allowance::new(plan.config).map_err(io::Error::other)?;
    let steps_allowed = allowance.stopping;
    let [socket_s, line_s] = ANSWER_MAX_S;
    let requires = format!(
        "{tries} of {tries} stops are answered, on the socket within {socket_s} s, by the command line within {line_s} s; \
         at most {steps_allowed} microsteps follow; the watchdog is fed"
    );
    type Test<'a> = &'a dyn Fn(&Daemon, &mut FaultResult) -> io::Result<()>;
    let run = |name: &str, requires: &str, test: Test<'_>| {
        let mut row = FaultResult::new(name, requires);
        row.steps_allowed = steps_allowed;
        let tested = Daemon::start(plan.program, &folder.join(name)).and_then(|daemon| {
            daemon.take_off()?;
            daemon.until(5.0, "motion", |s| s["mode"] == "tracking")?;
            test(&daemon, &mut row)
        });
        tested.unwrap_or_else(|e| row.fail(e.to_string()));
        row
    };
    let mut rows = Vec::new();
    for (name, attack, moves) in ATTACKS.into_iter().filter(|(name, ..)| selected(name)) {
        rows.push(run(name, &requires, &|daemon, row| {
            one(daemon, attack, tries, moves, row)
        }));
    }
    if selected(HUNG_COMMANDS) {
        let requires = "the tip stops by itself within 2 s";
        rows.push(run(HUNG_COMMANDS, requires, &hung_commands));
    }
    Ok(rows)
}

fn one(
    daemon: &Daemon,
    attack: Attack,
    tries: u32,
    moves: bool,
    row: &mut FaultResult,
) -> io::Result<()> {
    while daemon.notification().is_some() {}
    let began = Instant::now();
    let attackers = attack.start(daemon)?;
    std::thread::sleep(Duration::from_millis(200));
    let (mut slowest_s, mut answered) = ([0.0f64; 2], 0);
    for n in 0..tries {
        if n > 0 && moves {
            move_again(daemon, n)?;
        }
        let way = n as usize % 2;
        let started = Instant::now();
        let reply = match way {
            0 => daemon.ask(&Request::Stop {}).map(drop),
            _ => daemon.command("stop"),
        };
        slowest_s[way] = slowest_s[way].max(started.elapsed().as_secs_f64());
        answered += u32::from(reply.is_ok());
        require!(row: reply.is_ok(); "stop {n}: {reply:?}");
        if moves {
            row.steps_after = row.steps_after.max(travelled(daemon)?);
        }
    }
    let heard = std::iter::from_fn(|| daemon.notification());
    let fed = heard.filter(|text| text.contains("WATCHDOG=1")).count();
    let expected = (began.elapsed().as_secs_f64() / WATCHDOG_S) as usize;
    drop(attackers);
    let status = daemon.until(10.0, "the latch", |s| s["stopped"] == true)?;
    row.state = mode_of(&status);
    row.detected_s = Some(slowest_s[0]);
    let [socket_ms, line_ms] = slowest_s.map(|s| s * 1e3);
    row.message = format!(
        "{answered} of {tries} answered, the slowest within {socket_ms:.1} ms on the socket, {line_ms:.1} ms by the command line; \
         {fed} heartbeats; {} late cycles of {}",
        status["late_cycles"], status["cycles"]
    );
    let in_time = (0..2).all(|way| slowest_s[way] <= ANSWER_MAX_S[way]);
    let steps = row.steps_after;
    require!(row: in_time; "too late: {}", row.message);
    require!(row: steps <= row.steps_allowed; "{steps} microsteps after the answer");
    // a thread that hangs for long ends the heartbeat, as it must
    require!(row: fed >= expected || matches!(attack, Hang(_));
        "{fed} heartbeats in {expected} time-outs of the watchdog");
    Ok(())
}

/// Arms and bends, however often the attackers get in the way.
fn move_again(daemon: &Daemon, n: u32) -> io::Result<()> {
    let dir_deg = if n.is_multiple_of(2) { 30.0 } else { 210.0 };
    let target = Request::bend(60.0, dir_deg, None, None);
    insist(ARM_MAX_S, || {
        // a loop that was late for the attackers' sake has tripped; without a fault this is refused
        let _ = daemon.ask(&Request::ResetFault {});
        daemon
            .ask(&Request::Arm {})
            .and_then(|_| daemon.ask(&target))
    })?;
    std::thread::sleep(Duration::from_millis(80));
    Ok(())
}

/// Microsteps of all channels after a stop, until twice the time that braking takes.
fn travelled(daemon: &Daemon) -> io::Result<i64> {
    let counted = || -> io::Result<[i64; 3]> {
        let mut status = insist(ARM_MAX_S, || daemon.ask(&Request::Status {}))?;
        Ok(serde_json::from_value(status["counted"].take())?)
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

fn hung_commands(daemon: &Daemon, row: &mut FaultResult) -> io::Result<()> {
    let started = Instant::now();
    let _attackers: Attackers = Hang("control").start(daemon)?;
    let mut reader = connect(&daemon.sockets()[1])?;
    while row.detected_s.is_none() && started.elapsed() < Duration::from_secs(5) {
        let status = ask(&mut reader, &Request::Status {})?;
        row.state = mode_of(&status);
        row.detected_s = (status["stopped"] == true).then(|| started.elapsed().as_secs_f64());
        let age_s = &status["thread_age_s"]["control"];
        row.message = format!("the command thread was silent for {age_s} s");
    }
    let after_s = row.detected_s;
    require!(row: after_s.is_some_and(|s| s <= 2.0); "stopped after {after_s:?} s");
    Ok(())
}
