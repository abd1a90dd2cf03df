//! Kills, stops and restarts.

use super::daemon::{Daemon, WATCHDOG_S, ask};
use crate::control::tick::RestartState;
use crate::drill::bench::{BenchConfig, FaultyMachine, bend};
use crate::drill::row::Row;
use crate::model::bend::Bend;
use crate::service::protocol::Request;
use crate::simulation::plant::InjectedFault;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::MachineError;
use crate::supervisor::mode::Mode;
use std::io;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// Microsteps between two positions, all channels.
pub fn distance(a: &[i32; 3], b: &[i32; 3]) -> i64 {
    a.iter().zip(b).map(|(a, b)| i64::from((a - b).abs())).sum()
}

/// SIGSTOP during a move: the heartbeat stops, the manager kills the service and starts it again, and the new service does
/// not move before `zero`.
pub fn stopped(program: &Path, folder: &Path) -> io::Result<Row> {
    let mut row = Row::new("sigstop", "the heartbeat stops; the next service is lost and moves only after `zero`");
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    daemon.until(5.0, "motion", |s| s["mode"] == "tracking")?;
    std::thread::sleep(Duration::from_millis(400));
    while daemon.notification().is_some() {}
    daemon.signal(libc::SIGSTOP);
    let started = Instant::now();
    let mut heartbeat = Instant::now();
    while heartbeat.elapsed().as_secs_f64() < WATCHDOG_S {
        if daemon.notification().is_some_and(|s| s.contains("WATCHDOG=1")) {
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
    let status = again.until(15.0, "a decision", |s| s["mode"] != "aligning" && s["mode"] != "boot")?;
    row.state = status["mode"].as_str().unwrap_or_default().to_owned();
    row.require(row.state == "lost", |row| format!("mode {} although the plant started at rest", row.state));
    let mut client = again.client()?;
    row.message = client.request(&Request::Arm {}).err().map(|f| f.message).unwrap_or_default();
    row.require(row.message.contains("zero"), |row| format!("`arm` was answered with `{}`", row.message));
    ask(&mut client, &Request::Zero { straight: false })?;
    again.until(15.0, "alignment", |s| s["mode"] == "disarmed")?;
    let (success, _) = again.end()?;
    row.require(success, |_| "the service did not end with success".to_owned());
    Ok(row)
}

/// A restart with a bent tip. If the tip is where it was, the service continues; if it was moved meanwhile, `zero` is
/// required. In neither case does it move.
pub fn while_bent(config: &BenchConfig) -> io::Result<Row> {
    let mut row = Row {
        state: "disarmed".to_owned(),
        ..Row::new("restart_while_bent", "no microstep; an unmoved tip continues within 2.5°, a moved one is lost")
    };
    let mut restart_both = || -> Result<(), MachineError> {
        for moved in [false, true] {
            let mut bench = config.bench(0, 1)?;
            bench.until(10.0, |t| t.mode == Mode::Disarmed)?;
            bench.turn(Some(Order::Arm))?;
            bench.run(0.05)?;
            bench.turn(Some(bend(55.0, 100.0)))?;
            bench.run(2.5)?;
            let (restart, now_s) = (bench.runner.supervisor.keep(), bench.now_s);
            let mut machine = bench.runner.machine;
            if moved {
                machine.inject(InjectedFault::Push { bend_deg: 15.0, dir_deg: 200.0 });
            }
            restart_bent(config, machine, restart, now_s, moved, &mut row)?;
        }
        Ok(())
    };
    restart_both().map_err(io::Error::other)?;
    Ok(row)
}

fn restart_bent(
    config: &BenchConfig,
    machine: FaultyMachine,
    restart: RestartState,
    now_s: f64,
    moved: bool,
    row: &mut Row,
) -> Result<(), MachineError> {
    let mut bench = config.bench_on(machine, Some(restart), now_s);
    let first = bench.turn(None)?;
    let decided = bench.until(10.0, |t| t.mode != Mode::Aligning && t.mode != Mode::Boot)?;
    let output = bench.run(1.0)?;
    row.require(decided, |_| "no decision".to_owned());
    let steps = distance(&output.counted.0, &first.counted.0);
    row.steps_after += steps;
    row.require(output.steps == restart.steps && steps == 0, |_| format!("moved by {steps} microsteps"));
    let expected = if moved { Mode::Lost } else { Mode::Disarmed };
    row.require(output.mode == expected, |_| format!("mode {} instead of {expected}", output.mode));
    if !moved {
        row.detected_s = Some(bench.now_s - now_s - 1.0);
    }
    let armed = bench.turn(Some(Order::Arm))?.answer;
    if moved {
        row.message = armed.and_then(Result::err).map(|r| r.to_string()).unwrap_or_default();
        return Ok(());
    }
    bench.run(0.05)?;
    bench.turn(Some(bend(35.0, 150.0)))?;
    bench.run(3.0)?;
    row.error_deg_after = (bench.true_bend().0 - Bend::from_deg(35.0, 150.0).0).norm().to_degrees();
    row.require(row.error_deg_after < 2.5, |row| format!("error {:.1}° after the restart", row.error_deg_after));
    Ok(())
}

/// A calibration of another tip.
pub fn stale_calibration(program: &Path, folder: &Path) -> io::Result<Row> {
    let text = "[transmission]\nk_epsilon = [2.2, 2.5, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.8]\ntip = \"A-17\"\n";
    refused_start(program, folder, "stale_calibration", &["--tip", "B-3", "--calib"], text, &["A-17", "B-3"])
}

/// An invalid board file.
pub fn wrong_board(program: &Path, folder: &Path) -> io::Result<Row> {
    let text = "[limits]\ntravel_mm = 3000.0\n\n[plant]\n";
    refused_start(program, folder, "wrong_board_file", &["--board"], text, &["limits.travel_mm", "line 2"])
}

/// Starts the service with a file that it must refuse with exit code 2, with a message that contains `parts`.
fn refused_start(program: &Path, folder: &Path, name: &str, options: &[&str], text: &str, parts: &[&str]) -> io::Result<Row> {
    std::fs::create_dir_all(folder)?;
    let (file, socket) = (folder.join("file.toml"), folder.join("control.sock"));
    std::fs::write(&file, text)?;
    let started = Instant::now();
    let mut command = Command::new(program);
    command.arg("run").args(options).arg(&file).arg("--socket").arg(&socket).arg("--state").arg(folder.join("state"));
    let out = command.output()?;
    let detected_s = Some(started.elapsed().as_secs_f64());
    // the message without the frame that surrounds it on a terminal
    let stderr = String::from_utf8_lossy(&out.stderr);
    let message = stderr.split_whitespace().filter(|w| !w.chars().all(|c| "│╰╭─×·▶".contains(c))).collect::<Vec<_>>().join(" ");
    let mut row = Row {
        detected_s,
        state: "refused".to_owned(),
        message,
        ..Row::new(name, "the start is refused with exit code 2 and a message that names the mend; no socket is created")
    };
    row.require(out.status.code() == Some(2), |_| format!("ended with {}", out.status));
    row.require(!socket.exists(), |_| "the socket was created".to_owned());
    let complete = parts.iter().all(|p| row.message.contains(p));
    row.require(complete, |row| format!("the message is `{}`", row.message));
    Ok(row)
}
