//! Kills, stops and restarts.

use super::daemon::{Daemon, WATCHDOG_S, mode_of};
use crate::drill::bench::{Bench, BenchConfig, bend};
use crate::drill::row::FaultResult;
use crate::model::Bend;
use crate::service::protocol::Request;
use crate::supervisor::{MachineError, Mode, Order};
use serde_json::{Value, json};
use std::io;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// Microsteps between two positions, all channels.
pub fn distance(a: &[i32; 3], b: &[i32; 3]) -> i64 {
    a.iter().zip(b).map(|(a, b)| i64::from((a - b).abs())).sum()
}

/// SIGSTOP during a move: the heartbeat stops, the manager kills the service and starts it again, and the new service, whose
/// plant begins at rest, does not move before `arm`.
pub fn stopped(program: &Path, folder: &Path) -> io::Result<FaultResult> {
    let requires =
        "the heartbeat stops; the next service is disarmed, at rest, and moves only after `arm`";
    let mut row = FaultResult::new("sigstop", requires);
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    daemon.until(5.0, "motion", |s| s["mode"] == "tracking")?;
    std::thread::sleep(Duration::from_millis(400));
    while daemon.notification().is_some() {}
    daemon.signal(libc::SIGSTOP);
    let started = Instant::now();
    let mut heartbeat = Instant::now();
    while heartbeat.elapsed().as_secs_f64() < WATCHDOG_S {
        let heard = daemon.notification();
        if heard.is_some_and(|s| s.contains("WATCHDOG=1")) {
            heartbeat = Instant::now();
        }
        if started.elapsed().as_secs_f64() > 10.0 {
            row.fail("a stopped service continues to send heartbeats");
            break;
        }
    }
    row.detected_s = Some(started.elapsed().as_secs_f64());
    daemon.kill();
    let again = Daemon::start(program, folder)?;
    let decided = |s: &Value| s["mode"] != "aligning" && s["mode"] != "boot";
    let status = again.until(15.0, "a decision", decided)?;
    row.state = mode_of(&status);
    row.require(row.state == "disarmed", |row| {
        format!("mode {} although the plant started at rest", row.state)
    });
    let counted = &status["counted"];
    row.require(*counted == json!([0, 0, 0]), |_| {
        format!("the pistons are counted at {counted}")
    });
    let bend = Request::bend(20.0, 0.0, None);
    row.message = again
        .client()?
        .request(&bend)
        .err()
        .map(|refusal| refusal.message)
        .unwrap_or_default();
    let named = row.message.contains("arm");
    row.require(named, |row| {
        format!("`bend` was answered with `{}`", row.message)
    });
    let (success, _) = again.end()?;
    row.require(success, |_| "the service did not end with success");
    Ok(row)
}

/// A restart with a bent tip. If the tip is where it was, the service continues; if it was moved meanwhile, `zero` is
/// required. In neither case does it move.
pub fn while_bent(config: &BenchConfig) -> io::Result<FaultResult> {
    let requires = "no microstep; an unmoved tip continues within 2.5°, a moved one is lost";
    let mut row = FaultResult::new("restart_while_bent", requires).ending("disarmed");
    let mut restart_both = || -> Result<(), MachineError> {
        for moved in [false, true] {
            let mut bench = config.bench(0, 1)?;
            bench.until(10.0, |t| t.mode == Mode::Disarmed)?;
            bench.arm()?;
            bench.turn(Some(bend(55.0, 100.0)))?;
            bench.run(2.5)?;
            restart_bent(config, bench, moved, &mut row)?;
        }
        Ok(())
    };
    restart_both().map_err(io::Error::other)?;
    Ok(row)
}

/// Restarts the supervisor of a bent tip, which may have been `moved`.
fn restart_bent(
    config: &BenchConfig,
    before: Bench,
    moved: bool,
    row: &mut FaultResult,
) -> Result<(), MachineError> {
    let (restart, now_s) = (before.runner.supervisor.keep(), before.now_s);
    let mut machine = before.runner.machine;
    if moved {
        machine.plant().faults.push = Bend::from_deg(15.0, 200.0);
    }
    let mut bench = config.bench_on(machine, Some(restart), now_s);
    let first = bench.turn(None)?;
    let decided = bench.until(10.0, |t| t.mode != Mode::Aligning && t.mode != Mode::Boot)?;
    let output = bench.run(1.0)?;
    row.require(decided, |_| "no decision");
    let steps = distance(&output.counted.0, &first.counted.0);
    row.steps_after += steps;
    let stood = output.steps == restart.steps && steps == 0;
    row.require(stood, |_| format!("moved by {steps} microsteps"));
    let (mode, expected) = (output.mode, if moved { Mode::Lost } else { Mode::Disarmed });
    row.require(mode == expected, |_| {
        format!("mode {mode} instead of {expected}")
    });
    if !moved {
        row.detected_s = Some(bench.now_s - now_s - 1.0);
    }
    let armed = bench.turn(Some(Order::Arm))?.answer;
    if moved {
        let refusal = armed.and_then(Result::err);
        row.message = refusal.map(|r| r.to_string()).unwrap_or_default();
        return Ok(());
    }
    bench.run(0.05)?;
    bench.turn(Some(bend(35.0, 150.0)))?;
    bench.run(3.0)?;
    let error_deg = bench.error_deg(35.0, 150.0);
    row.require(error_deg < 2.5, |_| {
        format!("error {error_deg:.1}° after the restart")
    });
    row.error_deg_after = error_deg;
    Ok(())
}

/// A calibration of another tip.
pub fn stale(program: &Path, folder: &Path) -> io::Result<FaultResult> {
    let text = "[transmission]\nk_epsilon = [2.2, 2.5, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.8]\ntip = \"A-17\"\n";
    let row = FaultResult::new("stale_calibration", REFUSED);
    refused_start(
        program,
        folder,
        row,
        &["--tip", "B-3", "--calib"],
        text,
        &["A-17", "B-3"],
    )
}

/// An invalid board file.
pub fn wrong_board(program: &Path, folder: &Path) -> io::Result<FaultResult> {
    let text = "[limits]\ntravel_mm = 3000.0\n\n[plant]\n";
    let row = FaultResult::new("wrong_board_file", REFUSED);
    refused_start(
        program,
        folder,
        row,
        &["--board"],
        text,
        &["limits.travel_mm", "line 2"],
    )
}

const REFUSED: &str =
    "the start is refused with exit code 2 and a message that names the mend; no socket is created";

/// Starts the service with a file that it must refuse with exit code 2, with a message that contains `parts`.
fn refused_start(
    program: &Path,
    folder: &Path,
    row: FaultResult,
    options: &[&str],
    text: &str,
    parts: &[&str],
) -> io::Result<FaultResult> {
    std::fs::create_dir_all(folder)?;
    let (file, socket) = (folder.join("file.toml"), folder.join("control.sock"));
    std::fs::write(&file, text)?;
    let started = Instant::now();
    let mut command = Command::new(program);
    command
        .arg("run")
        .args(options)
        .arg(&file)
        .arg("--socket")
        .arg(&socket);
    let out = command.arg("--state").arg(folder.join("state")).output()?;
    let mut row = row.ending("refused");
    row.detected_s = Some(started.elapsed().as_secs_f64());
    row.message = String::from_utf8_lossy(&out.stderr).trim().to_owned();
    row.require(out.status.code() == Some(2), |_| {
        format!("ended with {}", out.status)
    });
    row.require(!socket.exists(), |_| "the socket was created");
    let complete = parts.iter().all(|p| row.message.contains(p));
    row.require(complete, |row| format!("the message is `{}`", row.message));
    Ok(row)
}
