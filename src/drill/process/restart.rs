//! Kills, stops and restarts.

use super::daemon::{Daemon, WATCHDOG_S, mode_of};
use super::plan::Plan;
use crate::drill::bench::{BenchConfig, bend, distance};
use crate::drill::row::{FaultResult, require};
use crate::service::Request;
use crate::supervisor::{Bend, MachineError, Mode, Order};
use nix::sys::signal::Signal;
use serde_json::{Value, json};
use std::io;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// SIGSTOP during a move: the heartbeat stops, the manager kills the service and starts it again, and the new service, whose
/// plant begins at rest, does not move before `arm`.
pub fn stopped(plan: &Plan<'_>, folder: &Path) -> io::Result<FaultResult> {
    let requires =
        "the heartbeat stops; the next service is disarmed, at rest, and moves only after `arm`";
    let mut row = FaultResult::new("sigstop", requires);
    let daemon = Daemon::start(plan.program, folder)?;
    daemon.take_off()?;
    daemon.until(5.0, "motion", |s| s["mode"] == "tracking")?;
    std::thread::sleep(Duration::from_millis(400));
    while daemon.notification().is_some() {}
    daemon.signal(Signal::SIGSTOP);
    let started = Instant::now();
    let mut heartbeat = Instant::now();
    while heartbeat.elapsed().as_secs_f64() < WATCHDOG_S {
        if daemon.hears("WATCHDOG=1") {
            heartbeat = Instant::now();
        }
        if started.elapsed().as_secs_f64() > 10.0 {
            row.fail("a stopped service continues to send heartbeats");
            break;
        }
    }
    row.detected_s = Some(started.elapsed().as_secs_f64());
    daemon.kill();
    let again = Daemon::start(plan.program, folder)?;
    let decided = |s: &Value| s["mode"] != "aligning" && s["mode"] != "boot";
    let status = again.until(15.0, "a decision", decided)?;
    row.state = mode_of(&status);
    require!(row: row.state == "disarmed"; "mode {} although the plant started at rest", row.state);
    let counted = &status["counted"];
    require!(row: *counted == json!([0, 0, 0]); "the pistons are counted at {counted}");
    let away = Request::bend(20.0, 0.0, None, None);
    let refusal = again.client()?.request(&away).err();
    row.message = refusal.map(|r| r.message).unwrap_or_default();
    require!(row: row.message.contains("arm"); "`bend` was answered with `{}`", row.message);
    require!(row: again.end()?.0; "the service did not end with success");
    Ok(row)
}

/// A restart with a bent tip. If the tip is where it was, the service continues; if it was moved meanwhile, `zero` is
/// required. In neither case does it move.
pub fn while_bent(plan: &Plan<'_>, _: &Path) -> io::Result<FaultResult> {
    let requires = "no microstep; an unmoved tip continues within 2.5°, a moved one is lost";
    let mut row = FaultResult::new("restart_while_bent", requires).ending("disarmed");
    for moved in [false, true] {
        restart_bent(plan.config, moved, &mut row).map_err(io::Error::other)?;
    }
    Ok(row)
}

/// Restarts the supervisor of a bent tip, which may have been `moved`.
fn restart_bent(
    config: &BenchConfig,
    moved: bool,
    row: &mut FaultResult,
) -> Result<(), MachineError> {
    let mut before = config.bench(0, 1)?;
    before.until(10.0, |t| t.mode == Mode::Disarmed)?;
    before.arm()?;
    before.turn(Some(bend(55.0, 100.0)))?;
    before.run(2.5)?;
    let (restart, now_s) = (before.runner.supervisor.keep(), before.now_s);
    let mut machine = *before.runner.machine;
    if moved {
        machine.plant().faults.push = Bend::from_deg(15.0, 200.0);
    }
    let mut bench = config.bench_on(machine, Some(restart), now_s);
    let first = bench.turn(None)?;
    let decided = bench.until(10.0, |t| t.mode != Mode::Aligning && t.mode != Mode::Boot)?;
    let output = bench.run(1.0)?;
    require!(row: decided; "no decision");
    let steps = distance(&output.counted, &first.counted);
    row.steps_after += steps;
    require!(row: output.steps == restart.steps && steps == 0; "moved by {steps} microsteps");
    let (mode, expected) = (output.mode, if moved { Mode::Lost } else { Mode::Disarmed });
    require!(row: mode == expected; "mode {mode} instead of {expected}");
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
    require!(row: error_deg < 2.5; "error {error_deg:.1}° after the restart");
    row.error_deg_after = error_deg;
    Ok(())
}

/// A calibration of another tip.
pub fn stale(plan: &Plan<'_>, folder: &Path) -> io::Result<FaultResult> {
    let text = "[transmission]\nk_epsilon = [2.2, 2.5, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.8]\ntip = \"A-17\"\n";
    let row = FaultResult::new("stale_calibration", REFUSED);
    let (options, parts) = (["--tip", "B-3", "--calib"], ["A-17", "B-3"]);
    refused_start(plan, folder, row, &options, text, &parts)
}

/// An invalid board file.
pub fn wrong_board(plan: &Plan<'_>, folder: &Path) -> io::Result<FaultResult> {
    let text = "[limits]\ntravel_mm = 3000.0\n\n[plant]\n";
    let row = FaultResult::new("wrong_board_file", REFUSED);
    let parts = ["limits.travel_mm", "line 2"];
    refused_start(plan, folder, row, &["--board"], text, &parts)
}

const REFUSED: &str =
    "the start is refused with exit code 2 and a message that names the mend; no socket is created";

/// Starts the service with a file that it must refuse with exit code 2, with a message that contains `parts`.
fn refused_start(
    plan: &Plan<'_>,
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
    let mut command = Command::new(plan.program);
    command.arg("run").args(options).arg(&file);
    command.arg("--socket").arg(&socket);
    let out = command.arg("--state").arg(folder.join("state")).output()?;
    let mut row = row.ending("refused");
    row.detected_s = Some(started.elapsed().as_secs_f64());
    row.message = String::from_utf8_lossy(&out.stderr).trim().to_owned();
    require!(row: out.status.code() == Some(2); "ended with {}", out.status);
    require!(row: !socket.exists(); "the socket was created");
    require!(row: parts.iter().all(|p| row.message.contains(p)); "the message is `{}`", row.message);
    Ok(row)
}
