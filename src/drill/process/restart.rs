//! Kills, stops and restarts.

use super::{Daemon, WATCHDOG_S, ask};
use crate::drill::Row;
use crate::drill::bench::{Breakable, Make, bend};
use crate::service::memory::Store;
use crate::service::protocol::Request;
use crate::simulation::plant::InjectedFault;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::mode::Mode;
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn world(e: impl std::fmt::Display) -> io::Error {
    io::Error::other(e.to_string())
}

/// `kill -9` at so many random instants of a service's work with its memory: arming, moving, disarming.
/// After each, the memory must be there, no older than what was acknowledged, and a pilot that starts
/// from it on a machine that is elsewhere must not move.
pub fn killed(make: &Make, program: &Path, folder: &Path, kills: u32) -> io::Result<Row> {
    let mut row = Row::process("sigkill", None, "lost", String::new());
    let (mut slowest_s, mut at_rest, mut doubted, mut torn, mut seed) = (0.0f64, 0, 0, 0, 0x2545_f491_4f6c_dd1du64);
    for n in 0..kills {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        let acknowledged = kill_at(program, folder, Duration::from_micros(seed % 40_000))?;
        let begun = Instant::now();
        let (store, recall) = Store::open(folder).map_err(world)?;
        drop(store);
        slowest_s = slowest_s.max(begun.elapsed().as_secs_f64());
        torn += usize::from(!recall.set_aside.is_empty());
        row.demand(!recall.unknown, |_| format!("kill {n}: nothing could be recalled: {:?}", recall.set_aside));
        let Some(memory) = recall.memory else {
            row.demand(acknowledged.is_none(), |_| format!("kill {n}: what was acknowledged is gone"));
            continue;
        };
        let (Some(kept), Some((steps, armed))) = (memory.kept, acknowledged) else { continue };
        // what is on the disk is what was acknowledged last, or one write newer
        let same = kept.steps.0 == steps && memory.armed == armed;
        row.demand(same || recall_is_newer(folder, steps), |_| {
            format!("kill {n}: {:?} was acknowledged, {:?} is remembered", steps, kept.steps.0)
        });
        if !memory.armed {
            at_rest += 1;
            row.demand(kept.steps.0 == [0; 3], |_| format!("kill {n}: disarmed away from zero"));
            continue;
        }
        let (moved, mode) = start_elsewhere(make, kept)?;
        row.steps_after += moved;
        doubted += usize::from(mode == Mode::Lost);
        let bent = kept.bend_rad[0].hypot(kept.bend_rad[1]).to_degrees();
        row.demand(moved == 0, |_| format!("kill {n}: moved by {moved} microsteps at restart"));
        row.demand(bent < 8.0 || mode == Mode::Lost, |_| format!("kill {n}: remembered {bent:.0}°, found straight, came to {mode}"));
    }
    row.detected_s = Some(slowest_s);
    row.message = format!(
        "{kills} kills: {at_rest} at rest, {doubted} asked for `zero`, {torn} torn slots set aside, none lost; recalled within {:.1} ms",
        slowest_s * 1e3
    );
    Ok(row)
}

/// A newer write than the acknowledged one may have reached the disk before the kill.
fn recall_is_newer(folder: &Path, acknowledged: [i32; 3]) -> bool {
    let read = |name: &str| std::fs::read(folder.join(name)).ok().and_then(|t| crate::service::memory::parse(&t).ok().flatten());
    let slots: Vec<_> = ["memory.a", "memory.b"].into_iter().filter_map(read).collect();
    let Some(newest) = slots.iter().map(|(seq, _)| *seq).max() else { return false };
    // the acknowledged one must then still be in the other slot
    slots.iter().any(|(seq, m)| *seq + 1 == newest && m.kept.is_some_and(|k| k.steps.0 == acknowledged))
}

/// Lets a child work with the memory and kills it after a while; what it had acknowledged last.
fn kill_at(program: &Path, folder: &Path, after: Duration) -> io::Result<Option<([i32; 3], bool)>> {
    std::fs::create_dir_all(folder)?;
    let mut child = Command::new(program)
        .args(["drill", "--exercise"])
        .arg(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()?;
    let pipe = child.stdout.take().ok_or_else(|| io::Error::other("no pipe"))?;
    let mut lines = BufReader::new(pipe).lines();
    // the clock starts with its first word, so that short delays hit its work and not its start
    let mut last = lines.next().transpose()?;
    std::thread::sleep(after);
    child.kill()?;
    child.wait()?;
    for line in lines {
        // a line cut by the kill is not an acknowledgement
        match line {
            Ok(line) if line.ends_with('.') => last = Some(line),
            _ => {}
        }
    }
    let words: Vec<i32> = last.unwrap_or_default().trim_end_matches('.').split(' ').filter_map(|w| w.parse().ok()).collect();
    Ok(match words[..] {
        [armed, a, b, c] => Some(([a, b, c], armed == 1)),
        _ => None,
    })
}

/// A restart on a machine that stands at rest: microsteps emitted in three seconds, and the mode.
fn start_elsewhere(make: &Make, kept: crate::control::tick::RestartState) -> io::Result<(i64, Mode)> {
    let machine = Breakable::new(make.sim(0, 3).map_err(world)?);
    let mut bench = make.bench_on(machine, Some(kept), 0.0);
    let turned = bench.run(3.0).map_err(world)?;
    let moved = (0..3).map(|i| i64::from((turned.counted.0[i] - kept.steps.0[i]).abs())).sum();
    Ok((moved, turned.mode))
}

/// The service is stopped in mid-motion: the watchdog is no longer fed, the manager kills and starts
/// again, and what comes up asks before it moves.
pub fn stopped(program: &Path, folder: &Path) -> io::Result<Row> {
    let mut row = Row::process("sigstop", None, "lost", String::new());
    let daemon = Daemon::start(program, folder)?;
    daemon.take_off()?;
    daemon.until(5.0, "motion", |s| s["mode"] == "tracking")?;
    std::thread::sleep(Duration::from_millis(400));
    while daemon.heard().is_some() {}
    daemon.signal(libc::SIGSTOP);
    let begun = Instant::now();
    let mut fed = Instant::now();
    while fed.elapsed().as_secs_f64() < WATCHDOG_S {
        if daemon.heard().is_some_and(|s| s.contains("WATCHDOG=1")) {
            fed = Instant::now();
        }
        if begun.elapsed().as_secs_f64() > 10.0 {
            row.fail("a stopped service went on feeding the watchdog");
            break;
        }
    }
    row.detected_s = Some(begun.elapsed().as_secs_f64());
    daemon.kill();
    let again = Daemon::start(program, folder)?;
    let status = again.until(15.0, "a decision", |s| s["mode"] != "aligning" && s["mode"] != "boot")?;
    row.state = status["mode"].as_str().unwrap_or_default().to_owned();
    row.demand(row.state == "lost", |row| format!("the plant began anew and the service came to {}", row.state));
    let mut client = again.client()?;
    let refused = client.ask(&Request::Arm {}).err().map(|f| f.words).unwrap_or_default();
    row.demand(refused.contains("zero"), |_| format!("arming said `{refused}`"));
    row.message = refused;
    ask(&mut client, &Request::Zero {})?;
    again.until(15.0, "alignment", |s| s["mode"] == "disarmed")?;
    let (well, _) = again.end()?;
    row.demand(well, |_| "it did not end well".to_owned());
    Ok(row)
}

/// The service is restarted while the tip is bent: where it still is, it goes on; where it was moved
/// meanwhile, it asks. In neither case does it move.
pub fn while_bent(make: &Make) -> io::Result<Row> {
    let mut row = Row::process("restart_while_bent", None, "disarmed", String::new());
    let mut bench = make.bench(0, 1).map_err(world)?;
    bench.until(10.0, |t| t.mode == Mode::Disarmed).map_err(world)?;
    bench.turn(Some(Order::Arm)).map_err(world)?;
    bench.run(0.05).map_err(world)?;
    bench.turn(Some(bend(55.0, 100.0))).map_err(world)?;
    bench.run(2.5).map_err(world)?;
    let (kept, now_s) = (bench.runner.supervisor.keep(), bench.now_s);
    for moved in [false, true] {
        let mut machine = bench.runner.machine.clone();
        if moved {
            machine.inject(InjectedFault::Push { bend_deg: 15.0, dir_deg: 200.0 });
        }
        let mut again = make.bench_on(machine, Some(kept), now_s);
        let first = again.turn(None).map_err(world)?;
        let decided = again.until(10.0, |t| t.mode != Mode::Aligning && t.mode != Mode::Boot).map_err(world)?;
        let turned = again.run(1.0).map_err(world)?;
        row.demand(decided, |_| "never decided".to_owned());
        let steps: i64 = (0..3).map(|i| i64::from((turned.counted.0[i] - first.counted.0[i]).abs())).sum();
        row.steps_after += steps;
        row.demand(turned.steps == kept.steps && steps == 0, |_| format!("moved by {steps} microsteps"));
        let right = if moved { Mode::Lost } else { Mode::Disarmed };
        row.demand(turned.mode == right, |_| format!("came to {} where {right} is right", turned.mode));
        if moved {
            row.message =
                again.turn(Some(Order::Arm)).map_err(world)?.answer.and_then(Result::err).map(|r| r.to_string()).unwrap_or_default();
        } else {
            row.detected_s = Some(again.now_s - now_s - 1.0);
            again.turn(Some(Order::Arm)).map_err(world)?;
            again.run(0.05).map_err(world)?;
            again.turn(Some(bend(35.0, 150.0))).map_err(world)?;
            again.run(3.0).map_err(world)?;
            row.error_deg_after = (again.true_bend().0 - crate::model::bend::Bend::from_deg(35.0, 150.0).0).norm().to_degrees();
            row.demand(row.error_deg_after < 2.5, |row| format!("{:.1}° off after it went on", row.error_deg_after));
        }
    }
    Ok(row)
}

/// A calibration that was made on another tip.
pub fn stale_calibration(program: &Path, folder: &Path) -> io::Result<Row> {
    std::fs::create_dir_all(folder)?;
    let calib = folder.join("calib.toml");
    std::fs::write(&calib, "[transmission]\nk_epsilon = [2.2, 2.5, 2.2]\nk_lambda_mm = [0.9, 0.9, 0.8]\ntip = \"A-17\"\n")?;
    let mut row = refused_start(program, folder, "stale_calibration", &["--tip", "B-3", "--calib", &calib.display().to_string()])?;
    row.demand(row.message.contains("A-17") && row.message.contains("B-3"), |row| format!("said `{}`", row.message));
    Ok(row)
}

/// A board file that is not one.
pub fn wrong_board(program: &Path, folder: &Path) -> io::Result<Row> {
    std::fs::create_dir_all(folder)?;
    let board = folder.join("board.toml");
    std::fs::write(&board, "[limits]\ntravel_mm = 3000.0\n\n[plant]\n")?;
    let mut row = refused_start(program, folder, "wrong_board_file", &["--board", &board.display().to_string()])?;
    row.demand(row.message.contains("limits.travel_mm") && row.message.contains("line 2"), |row| format!("said `{}`", row.message));
    Ok(row)
}

fn refused_start(program: &Path, folder: &Path, name: &str, args: &[&str]) -> io::Result<Row> {
    let begun = Instant::now();
    let socket = folder.join("control.sock");
    let out = Command::new(program).arg("run").args(args).arg("--socket").arg(&socket).arg("--state").arg(folder.join("state")).output()?;
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    let message: String = said.split_whitespace().filter(|w| !w.chars().all(|c| "│╰╭─×·▶".contains(c))).collect::<Vec<_>>().join(" ");
    let mut row = Row::process(name, Some(begun.elapsed().as_secs_f64()), "refused", message);
    row.demand(out.status.code() == Some(2), |_| format!("ended with {}", out.status));
    row.demand(!socket.exists(), |_| "opened its socket all the same".to_owned());
    Ok(row)
}
