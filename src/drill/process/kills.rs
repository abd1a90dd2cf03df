//! `kill -9` at random instants while a child works with the memory, and damage to the memory afterwards.

use crate::drill::bench::{Bench, BenchConfig, FaultyMachine};
use crate::drill::row::Row;
use crate::service::belief::Belief;
use crate::service::slot;
use crate::service::start::Start;
use crate::service::store::{Found, Recall, Store};
use crate::supervisor::cycle::runner::Runner;
use crate::supervisor::machine::{Machine, MachineError};
use crate::supervisor::mode::Mode;
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Largest error of a believed position, mm of bellow.
const BELIEVED_MAX_MM: f64 = 1.0;
/// Names of the slots.
const SLOTS: [&str; 2] = ["memory.a", "memory.b"];

/// What happens to the memory after a kill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Damage {
    None,
    Truncated,
    Zeroed,
    Swapped,
}

impl Damage {
    const ALL: [(Self, &'static str); 4] = [
        (Self::None, "sigkill"),
        (Self::Truncated, "sigkill_memory_truncated"),
        (Self::Zeroed, "sigkill_memory_zeroed"),
        (Self::Swapped, "sigkill_memory_swapped"),
    ];

    fn requires(self) -> &'static str {
        match self {
            Self::None => {
                "the last acknowledged write is recalled, or the memory counts as lost; no microstep; at most 1 mm of what is believed is false"
            }
            _ => "the position is lost; no microstep",
        }
    }

    fn apply(self, folder: &Path, slot: usize) -> io::Result<()> {
        let [one, other] = [slot % 2, 1 - slot % 2].map(|n| folder.join(SLOTS[n]));
        match self {
            Self::None => Ok(()),
            Self::Truncated => {
                let text = std::fs::read(&one)?;
                std::fs::write(&one, &text[..text.len() / 3])
            }
            Self::Zeroed => std::fs::write(&one, vec![0; std::fs::read(&one)?.len()]),
            Self::Swapped => {
                let (first, second) = (std::fs::read(&one)?, std::fs::read(&other)?);
                std::fs::write(&one, second)?;
                std::fs::write(&other, first)
            }
        }
    }
}

/// One row for each damage; `kills` in all.
pub fn rows(config: &BenchConfig, program: &Path, folder: &Path, kills: u32, selected: &dyn Fn(&str) -> bool) -> io::Result<Vec<Row>> {
    // xorshift (Marsaglia 2003)
    let mut random = 0x2545_f491_4f6c_dd1du64;
    let mut rows = Vec::new();
    for (damage, name) in Damage::ALL.into_iter().filter(|(_, name)| selected(name)) {
        let mut row = Row { state: "lost".to_owned(), ..Row::new(name, damage.requires()) };
        let mut count = [0; 3];
        for n in 0..kills.div_ceil(4) {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            let acknowledged = kill_after(program, folder, Duration::from_micros(random % 40_000))?;
            damage.apply(folder, n as usize)?;
            let started = Instant::now();
            let (store, recall) = Store::open(folder).map_err(io::Error::other)?;
            drop(store);
            let took_s = started.elapsed().as_secs_f64();
            row.detected_s = Some(row.detected_s.unwrap_or(0.0).max(took_s));
            if damage == Damage::None {
                check_recall(&mut row, n, folder, &recall, acknowledged);
            } else {
                row.require(Belief::in_recall(&recall, true) == Belief::Lost, |_| format!("kill {n}: a damaged memory is believed"));
            }
            let state = start_at_rest(config, &recall, &mut row, n).map_err(io::Error::other)?;
            count[match state {
                Mode::Disarmed => 0,
                Mode::Lost => 1,
                _ => 2,
            }] += 1;
        }
        row.require(count[2] == 0, |_| format!("{} starts came to no decision", count[2]));
        row.message = format!("believed after {} kills, lost after {}", count[0], count[1]);
        rows.push(row);
    }
    Ok(rows)
}

/// An undamaged memory holds the last acknowledged write, unless the kill tore one.
fn check_recall(row: &mut Row, n: u32, folder: &Path, recall: &Recall, acknowledged: Option<([i32; 3], bool)>) {
    if recall.found == Found::Damaged {
        return;
    }
    let remembered = recall.memory.as_ref().and_then(|m| Some((m.restart?.steps.0, m.armed)));
    let Some(acknowledged) = acknowledged else { return };
    let recalled = remembered == Some(acknowledged) || one_write_newer(folder, acknowledged.0);
    row.require(recalled, |_| format!("kill {n}: {acknowledged:?} was acknowledged, {remembered:?} was recalled"));
}

/// Starts a supervisor from the memory on a machine whose pistons are at rest. It must not move, and what it believes must
/// be true. Returns its mode.
fn start_at_rest(config: &BenchConfig, recall: &Recall, row: &mut Row, n: u32) -> Result<Mode, MachineError> {
    let machine = FaultyMachine::new(config.sim(0, 3)?, &config.board.drive_limits());
    let memory = recall.memory.clone().unwrap_or_default();
    let belief = Belief::in_recall(recall, true);
    let start = Start { config: config.supervisor(machine.info()), restart: memory.restart, belief, unverified: false };
    let mut bench: Bench = config.bench_on(machine, None, 0.0);
    bench.runner = Runner::new(bench.runner.machine, start.supervisor());
    let output = bench.run(3.0)?;
    let recounted = bench.runner.supervisor.keep();
    // the remembered counts are declared, not driven
    let remembered = memory.restart.map_or([0; 3], |r| r.steps.0);
    let steps: i64 = (0..3).map(|i| i64::from((output.counted.0[i] - remembered[i]).abs())).sum();
    row.steps_after += steps;
    row.require(steps == 0, |_| format!("kill {n}: moved by {steps} microsteps at the restart"));
    if output.mode == Mode::Disarmed {
        let radius_mm = bench.runner.supervisor.config().tick.geometry.r_mm;
        let false_mm = recounted.bend_rad[0].hypot(recounted.bend_rad[1]) * radius_mm;
        row.error_deg_after = row.error_deg_after.max((false_mm / radius_mm).to_degrees());
        row.require(false_mm <= BELIEVED_MAX_MM, |_| format!("kill {n}: {false_mm:.2} mm are believed falsely"));
    }
    Ok(output.mode)
}

/// True if one newer write than the acknowledged one reached the disk before the kill.
fn one_write_newer(folder: &Path, acknowledged: [i32; 3]) -> bool {
    let read = |name: &str| std::fs::read(folder.join(name)).ok().and_then(|t| slot::parse(&t).ok().flatten());
    let slots: Vec<_> = SLOTS.into_iter().filter_map(read).collect();
    let Some(newest) = slots.iter().map(|(sequence, _)| *sequence).max() else { return false };
    slots.iter().any(|(sequence, m)| *sequence + 1 == newest && m.restart.is_some_and(|r| r.steps.0 == acknowledged))
}

/// Kills an exercise after a time. Returns the last acknowledged write: position and armed.
fn kill_after(program: &Path, folder: &Path, after: Duration) -> io::Result<Option<([i32; 3], bool)>> {
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
    // the time counts from the first write, so that short times do not end before it
    let mut last = lines.next().transpose()?;
    std::thread::sleep(after);
    child.kill()?;
    child.wait()?;
    // a line without its end was cut by the kill and is not an acknowledgement
    last = lines.map_while(Result::ok).filter(|line| line.ends_with('.')).last().or(last);
    let numbers: Vec<i32> = last.unwrap_or_default().trim_end_matches('.').split(' ').filter_map(|w| w.parse().ok()).collect();
    Ok(match numbers[..] {
        [armed, a, b, c] => Some(([a, b, c], armed == 1)),
        _ => None,
    })
}
